"""Looking at a scan: its volumes, its materials, and where source and panel stand.

`content` says what there is to see, `load` reads it from a scene or a dataset, `drawing` puts it into a window of
several panels, `output` writes a picture or a page, or opens the window. Only the last two import pyvista.
"""
