"""How this package draws: one look for all pictures, written as PNG, PDF or SVG without any display."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from spectra.errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BLACK, RED, GRID = "black", "#D55E00", "0.9"
# Colours that the colour-blind tell apart (Okabe and Ito), each with dashes of its own.
LINES = (
    *(("#0072B2", (0, (4, 2))), ("#E69F00", (0, (1, 1))), ("#009E73", (0, (5, 1, 1, 1))), ("#CC79A7", (0, (2, 2)))),
    *(("#56B4E9", (0, (6, 1))), ("#F0E442", (0, (3, 1, 1, 1, 1, 1))), ("black", (0, (1, 2)))),
)
_STYLE: Any = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False, "legend.frameon": False}


def check_picture(path: Path) -> None:
    """Refuse a picture that cannot be written."""
    if path.suffix not in {".png", ".pdf", ".svg"}:
        raise InputError(f"a picture ends in .png, .pdf or .svg, got {path.name!r}")
    if not path.absolute().parent.is_dir():
        raise InputError(f"the folder {path.parent} for the picture {path.name} does not exist")


@contextmanager
def picture(path: Path, inches: tuple[float, float]) -> Iterator["Figure"]:
    """A figure that is written at the end."""
    check_picture(path)
    with styled_figure(inches) as figure:
        yield figure
        figure.savefig(path)


@contextmanager
def styled_figure(inches: tuple[float, float]) -> Iterator["Figure"]:
    """A figure that is drawn on without any display."""
    from matplotlib import rc_context  # noqa: PLC0415 - half a second
    from matplotlib.backends.backend_agg import FigureCanvasAgg  # noqa: PLC0415
    from matplotlib.figure import Figure  # noqa: PLC0415

    with rc_context(_STYLE):
        figure = Figure(figsize=inches, dpi=150, layout="constrained")
        FigureCanvasAgg(figure)
        yield figure


def channel_colours(count: int) -> Any:
    """Distinct colours in order of energy, dark to light."""
    from matplotlib import colormaps  # noqa: PLC0415

    return colormaps["viridis"](np.linspace(0.05, 0.9, count))
