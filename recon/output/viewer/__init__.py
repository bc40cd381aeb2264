"""Looking at a run: truth, result and difference of every basis, surfaces, and the Gaussians themselves.

`content` says what there is to see, `load` reads it from a run folder, `surfaces` and `markers` make shapes of it, and
`drawing` puts it into a window of several panels. How pictures and pages are written is the business of
`phantomgen.display.viewer`, which shows scans.
"""
