"""Output of the viewer of a run: a picture, a page, or a window."""

from pathlib import Path
from typing import TYPE_CHECKING

from phantomgen.display.viewer.output import put
from recon.output.viewer.content import RunContent
from recon.output.viewer.pointer import PointerValues
from spectra.errors import InputError

if TYPE_CHECKING:
    from phantomgen.display.viewer.output import Drawn


def show(
    content: RunContent,
    bases: list[int],
    levels: dict[str, float] | None,
    screenshot: Path | None,
    html: Path | None,
    size: tuple[int, int] | None = None,
    pointed: PointerValues | None = None,
) -> None:
    """Write the picture and the page that are named, or open a window where neither is.

    Parameters
    ----------
    content : content to show
    bases : numbers of the bases whose slices are shown; a window shows the first of them
    levels : levels of surfaces [1/mm]; see `recon.output.viewer.surfaces.surfaces`
    screenshot, html : files to write
    size : width and height of picture or window [pixel]; None for a size that holds all panels
    pointed : values that a window tells under the pointer; None for none
    """

    def draw(for_page: bool, off_screen: bool) -> "Drawn":
        from recon.output.viewer import drawing  # noqa: PLC0415 - pyvista

        shown = bases if off_screen else bases[:1]
        return drawing.draw(content, shown, levels, drawing.SIZE if for_page else size, off_screen, for_page, pointed)

    put(content.name, draw, screenshot, html)


def chosen_bases(content: RunContent, basis: str | None) -> list[int]:
    """Return the numbers of the bases that are asked for.

    Parameters
    ----------
    content : content to show
    basis : name of a basis; None for all

    Returns
    -------
    numbers of the bases

    Raises
    ------
    InputError
        When there is no such basis.
    """
    if basis is None:
        return list(range(len(content.basis_names)))
    if basis not in content.basis_names:
        raise InputError(f"{content.name} has no basis {basis!r}, only {', '.join(content.basis_names)}")
    return [content.basis_names.index(basis)]
