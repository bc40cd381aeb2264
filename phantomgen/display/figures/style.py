"""Style of all figures: one column wide, readable in print, safe for the colour-blind."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from phantomgen.runtime.disk import complete_file
from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH = 7.0  # inches: one column
PAGE_WIDTH = 4.7  # inches: half a page of a report, the whole width of a phone
RESULT, TRUTH = "#D55E00", "black"
MILLI, UNIT = 1e3, "10$^{-3}$ mm$^{-1}$"  # what coefficients are drawn in
_STYLE: Any = {
    "font.size": 8.5,
    "axes.titlesize": 9.0,
    "axes.labelsize": 8.5,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "legend.frameon": False,
    "legend.fontsize": 8.0,
    "lines.linewidth": 1.2,
    "lines.solid_joinstyle": "round",
    "axes.formatter.limits": (-3, 5),
    "axes.formatter.use_mathtext": True,
    "image.interpolation": "nearest",
}
GRAY, BLUE, BLACK, RED, GRID = "0.6", "#0072B2", "black", "#D55E00", "0.9"
# Colours that the colour-blind can distinguish (Okabe and Ito), each with dashes of its own.
LINES = (
    *(("#0072B2", (0, (4, 2))), ("#E69F00", (0, (1, 1))), ("#009E73", (0, (5, 1, 1, 1))), ("#CC79A7", (0, (2, 2)))),
    *(("#56B4E9", (0, (6, 1))), ("#F0E442", (0, (3, 1, 1, 1, 1, 1))), ("black", (0, (1, 2)))),
)
BASIS_LINES = ((BLUE, "-"), ("#E69F00", (0, (6, 2))), ("#CC79A7", (0, (2.5, 2))), ("#009E73", (0, (1, 1))))


_SCALABLE: Any = {"image.interpolation": "none", "svg.hashsalt": "spectral-ct"}  # pixels stay pixels, ids stay ids
_STAMPS = {
    "png": ("Software",),
    "svg": ("Date", "Creator"),
    "pdf": ("CreationDate", "Creator"),
}  # would differ each time


def check_picture(path: Path) -> None:
    """Refuse a picture that cannot be written.

    Parameters
    ----------
    path : the picture

    Raises
    ------
    InputError
        When the name does not end in .png, .pdf or .svg, or the folder does not exist.
    """
    _kind_of(path)
    if not path.absolute().parent.is_dir():
        raise InputError(f"the folder {path.parent} for the picture {path.name} does not exist")


def _kind_of(path: Path) -> str:
    """Return the format of a picture by its suffix."""
    kind = path.suffix.removeprefix(".")
    if kind not in _STAMPS:
        raise InputError(f"a picture ends in .png, .pdf or .svg, got {path.name!r}")
    return kind


@contextmanager
def styled_figure(inches: tuple[float, float], **style: Any) -> Iterator["Figure"]:
    """Yield a figure in the common style; it requires no display, and the backend of the process does not matter.

    Parameters
    ----------
    inches : width and height [inch]
    **style : settings of matplotlib that replace those of the common style

    Yields
    ------
    the figure
    """
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415

    from phantomgen.display.figures.notebook_figure import NotebookFigure  # noqa: PLC0415

    with rc_context(_STYLE | style):
        figure = NotebookFigure(figsize=inches, dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


@contextmanager
def figure_file(path: Path | None, inches: tuple[float, float]) -> Iterator["Figure"]:
    """Yield a figure that is written at the end: PNG, PDF, or SVG without a background, for pages.

    Parameters
    ----------
    path : the picture; None for no file
    inches : width and height [inch]

    Yields
    ------
    the figure
    """
    if path is None:
        with styled_figure(inches) as figure:
            yield figure
            figure.draw_without_rendering()  # ticks are made in the common style
        return
    kind = _kind_of(Path(path))
    with styled_figure(inches, **(_SCALABLE if kind == "svg" else {})) as figure:
        yield figure
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        _settle(figure)
        with complete_file(Path(path), f".{kind}") as beside:
            figure.savefig(beside, format=kind, transparent=kind == "svg", metadata=dict.fromkeys(_STAMPS[kind]))


def _settle(figure: "Figure") -> None:
    """Make the layout, which settles in two rounds where aspect ratios are fixed, and keep it while it is drawn."""
    engine = figure.get_layout_engine()
    assert engine is not None
    for _ in range(2):
        engine.execute(figure)
    figure.set_layout_engine("none")


def write_csv(path: Path | None, columns: dict[str, np.ndarray]) -> None:
    """Write columns of equal length as CSV beside the picture.

    Parameters
    ----------
    path : the picture or the CSV file; None for no file
    columns : values by name
    """
    if path is None:
        return
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    table = np.column_stack(list(columns.values()))
    options = {"fmt": "%.6g", "delimiter": ",", "header": ",".join(columns), "comments": "", "encoding": "utf-8"}
    np.savetxt(path.with_suffix(".csv"), table, **options)


def few_ticks(steps: int = 5) -> Any:
    """Return a locator of round numbers.

    Parameters
    ----------
    steps : largest number of steps between ticks

    Returns
    -------
    locator of matplotlib
    """
    from matplotlib.ticker import MaxNLocator  # noqa: PLC0415

    return MaxNLocator(steps, steps=[1, 2, 5, 10])


def decades_or_zero(ax: Any, values: np.ndarray) -> None:
    """Make the vertical axis logarithmic where positive values span a decade; otherwise begin it at 0.

    Parameters
    ----------
    ax : axes of matplotlib
    values : values that are drawn
    """
    positive = values[values > 0]
    if positive.max(initial=0.0) > 10 * positive.min(initial=np.inf):
        ax.set_yscale("log")
        ax.yaxis.set_major_formatter("{x:g}")
    else:
        ax.set_ylim(bottom=0)


def channel_colours(count: int) -> Any:
    """Return distinct colours in order of energy, dark to light.

    Parameters
    ----------
    count : number of colours

    Returns
    -------
    colours
    """
    from matplotlib import colormaps  # noqa: PLC0415

    return colormaps["viridis"](np.linspace(0.05, 0.9, count))
