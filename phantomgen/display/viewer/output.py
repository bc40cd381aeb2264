"""Output of the viewer: a picture, a page, or a window."""

import os
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from phantomgen.display.viewer.content import Content
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError

if TYPE_CHECKING:
    import pyvista

    from phantomgen.display.viewer.panes import Pane

    Drawn = tuple[pyvista.Plotter, list[Pane]]

NO_DISPLAY = (
    "there is no display to open a window on: write a picture by --screenshot view.png, or a page by --html view.html"
)


def check_outputs(screenshot: Path | None, html: Path | None, overwrite: bool) -> None:
    """Refuse outputs that cannot be written, or a window without a display, before any work is done.

    Parameters
    ----------
    screenshot : the picture, or None
    html : the page, or None
    overwrite : whether existing files may be replaced

    Raises
    ------
    InputError
        When an output is impossible.
    """
    for path, option, suffix in ((screenshot, "--screenshot", ".png"), (html, "--html", ".html")):
        if path is None:
            continue
        if path.suffix.lower() != suffix:
            raise InputError(f"{option} writes a {suffix} file, got {path}")
        check_output(path, overwrite, option)
    if screenshot is None and html is None and sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
        raise InputError(NO_DISPLAY)


def show(content: Content, screenshot: Path | None, html: Path | None, size: tuple[int, int] | None = None) -> None:
    """Write a picture and a page of a scan, or open a window where neither is named.

    Parameters
    ----------
    content : content of the viewer
    screenshot : the picture, or None
    html : the page, or None
    size : width and height of the window [pixel]
    """

    def draw(for_page: bool, off_screen: bool) -> "Drawn":
        from phantomgen.display.viewer import drawing  # noqa: PLC0415

        return drawing.draw(content, drawing.SIZE if for_page else size, off_screen, for_page)

    put(content.name, draw, screenshot, html)


def put(name: str, draw: "Callable[[bool, bool], Drawn]", screenshot: Path | None, html: Path | None) -> None:
    """Write a drawing as a picture and a page, or open a window where neither is named.

    Parameters
    ----------
    name : title of the page
    draw : function that creates a window and its panels, given whether for a page, and whether off screen
    screenshot, html : files to write
    """
    import pyvista  # noqa: PLC0415

    with pyvista.vtk_verbosity("off"):  # a machine without a display is nothing to warn of
        if screenshot is not None:
            plotter, _ = draw(False, True)
            picture = BytesIO()
            plotter.screenshot(picture)
            plotter.close()
            _write(screenshot, picture.getvalue())
        if html is not None:
            from phantomgen.display.viewer.page import page  # noqa: PLC0415

            plotter, panes = draw(True, True)
            _write(html, page(name, plotter, panes).encode())
            plotter.close()
        if screenshot is None and html is None:
            _open_window(draw(False, False)[0])


def _open_window(plotter: "pyvista.Plotter") -> None:
    """Open a window and wait until it is closed."""
    if type(plotter.render_window).__name__ in {"vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow"}:
        raise InputError(NO_DISPLAY)
    plotter.show()


def _write(path: Path, content: bytes) -> None:
    """Write beside the final name, then rename."""
    part = path.with_name(path.name + ".part")
    try:
        part.write_bytes(content)
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
