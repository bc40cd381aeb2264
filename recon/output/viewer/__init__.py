"""Viewer of a run: truth, result and difference of every basis, surfaces, and the Gaussians.

`content` has the numbers, `load` reads them from a run folder, `surfaces` and `ellipsoid_markers` create shapes, and
`drawing` draws them into a window of several panels. `phantomgen.display.viewer`, which shows scans, writes pictures
and pages.
"""
