"""Panels of a window: place, text, and camera."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

import numpy as np
import pyvista
from jaxtyping import Float
from matplotlib import colormaps, get_data_path
from matplotlib.colors import to_hex

INK, MUTED, FAINT = "#222222", "#666666", "#b4b4b4"
FONT = 17  # pixels in a window of 1600 x 1000
COLOUR_MAP = "viridis"
AXES = {"x": "#D55E00", "y": "#009E73", "z": "#0072B2"}
_LEGEND = 0.82  # most of a panel's height that a legend takes; its letters shrink where it is long
_DIGIT = 0.58  # width of a digit beside a colour bar, in font sizes
_LINE = 1.7  # height of a line of text, in font sizes
_FROM_FILE = 4  # VTK's code for a font that is read from a file


@dataclass
class Bar:
    """Colour bar of a panel.

    Parameters
    ----------
    unit : unit of the values
    low, top : values at both ends
    ticks : (part of the height, number) of each tick
    colour_map : its name
    colours : some of its colours
    """

    unit: str
    low: float
    top: float
    ticks: list[tuple[float, str]]
    colour_map: str
    colours: list[str]


@dataclass
class PaneText:
    """Text of a panel.

    Parameters
    ----------
    title : at the top
    note : below, or under the title where a legend stands below
    legend : (text, colour) of each entry
    bar : colour bar, or None
    """

    title: str = ""
    note: str = ""
    legend: list[tuple[str, str]] = field(default_factory=list)
    bar: Bar | None = None


@dataclass(frozen=True, eq=False)
class Pane:
    """Panel of a window.

    Parameters
    ----------
    plotter : the window
    place : row and column of the panel's first cell
    font : height of letters [pixel]
    for_page : whether words and axes are left to a page
    words : what is written in it
    """

    plotter: pyvista.Plotter
    place: tuple[int, int]
    font: int
    for_page: bool = False
    words: PaneText = field(default_factory=PaneText)

    @property
    def index(self) -> int:
        """Its number in the window."""
        return int(self.plotter.renderers.loc_to_index(self.place))

    @property
    def renderer(self) -> pyvista.Renderer:
        """The part of the window."""
        return self.plotter.renderers[self.index]

    @property
    def camera(self) -> pyvista.Camera:
        """Camera of the panel."""
        return cast("pyvista.Camera", self.renderer.camera)

    @property
    def viewport(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top in parts of the window."""
        left, bottom, right, top = self.renderer.viewport
        return left, bottom, right, top

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [pixel]."""
        x0, y0, x1, y1 = self.viewport
        width, height = self.plotter.window_size
        return (x1 - x0) * width, (y1 - y0) * height

    @property
    def camera_scale(self) -> float:
        """Half the height that the camera sees [mm]."""
        return float(self.camera.parallel_scale)

    def set_bar(self, top: float, count: int, low: float = 0.0, colour_map: str = COLOUR_MAP) -> None:
        """Give the panel a colour bar in 1/mm.

        Parameters
        ----------
        top : upper end
        count : number of ticks
        low : lower end
        colour_map : its name
        """
        number = _number_format((top - low) / (count - 1))
        ticks = [(part, number % (low + part * (top - low))) for part in np.linspace(0, 1, count).tolist()]
        colours = [to_hex(colormaps[colour_map](i / 15)) for i in range(16)]
        self.words.bar = Bar("1/mm", low, top, ticks, colour_map, colours)

    def stroke(self, mesh: pyvista.PolyData, colour: str, width: float) -> None:
        """Draw lines.

        Parameters
        ----------
        mesh : the lines
        colour : their colour
        width : in a page [pixel]
        """
        self.plotter.add_mesh(mesh, color=colour, line_width=width * self._widening)

    def dots(self, points: Float[np.ndarray, "point 3"], colour: str, width: float) -> None:
        """Draw points.

        Parameters
        ----------
        points : (point, 3) [mm]
        colour : their colour
        width : in a page [pixel]
        """
        mesh, size = pyvista.PolyData(points), width * self._widening
        self.plotter.add_mesh(mesh, color=colour, point_size=size, lighting=False, render_points_as_spheres=True)

    def mark_axes(self, corner: Float[np.ndarray, " 3"], length: float) -> None:
        """Draw three lines in the colours of the axes; only for a page, which has no other sign of them.

        Parameters
        ----------
        corner : where they begin [mm]
        length : of each line [mm]
        """
        if self.for_page:
            for direction, colour in zip(np.eye(3), AXES.values(), strict=True):
                self.stroke(pyvista.Line(corner, corner + length * direction), colour, 3)

    @property
    def _widening(self) -> float:
        """Lines of a picture are drawn wider, because its pixels are averaged over smaller ones."""
        return 1.0 if self.for_page else 1.6 * self.font / FONT

    def clear(self) -> None:
        """Remove what was drawn, text included; the camera does not move."""
        self.plotter.subplot(*self.place)
        bars = self.plotter.scalar_bars
        for title in [title for title, bar in bars.items() if self.renderer.HasViewProp(bar)]:
            bars.remove_scalar_bar(title, render=False)  # its slot is not freed otherwise
        self.renderer.clear_actors()
        vars(self.words).update(vars(PaneText()))

    def finish(self) -> None:
        """Draw all text and the axes into the panel."""
        self.plotter.subplot(*self.place)
        if self.for_page:
            return
        width, height = self.size
        left, line = self.font / width, self.font / height
        self._text(self.words.title, left, 1 - 2 * line, 1.15)
        self._text(self.words.note, left, 1 - 3.8 * line if self.words.legend else line, 0.9, MUTED)
        shrunk = min(1.0, _LEGEND / (line * _LINE * max(len(self.words.legend), 1)))
        for i, (name, colour) in enumerate(reversed(self.words.legend)):
            self._text("\N{BLACK SQUARE}", left, (1 + i * _LINE * shrunk) * line, shrunk, colour)
            self._text(name, (1 + 1.4 * shrunk) * left, (1 + i * _LINE * shrunk) * line, shrunk)
        if self.words.bar:
            self._write_bar(self.words.bar)
        if not self.renderer.axes_enabled:
            colours: Any = {f"{axis}_color": colour for axis, colour in AXES.items()}
            self.renderer.add_axes(color=INK, line_width=2, viewport=(0.86, 0.0, 1.0, 0.16), **colours)

    def tell(self, text: str) -> None:
        """Write lines below the title, in place of those written before.

        Parameters
        ----------
        text : lines; empty to remove them
        """
        self.plotter.subplot(*self.place)
        name = f"told {self.index}"
        if not text:
            plotter: Any = self.plotter  # whose decorated methods confuse type checkers
            plotter.remove_actor(name, render=False)
            return
        place = self.font / self.size[0], 1 - 2.8 * self.font / self.size[1]
        shown: Any = self.plotter.add_text(text, position=place, viewport=True, color=INK, name=name, render=False)
        shown.prop.SetVerticalJustificationToTop()
        _set_font(shown.prop, 0.9 * self.font)

    def _text(self, text: str, x: float, y: float, scale: float = 1.0, colour: str = INK) -> None:
        """A line that starts at (x, y), in parts of the panel."""
        if text:
            shown: Any = self.plotter.add_text(text, position=(x, y), viewport=True, color=colour)
            _set_font(shown.prop, scale * self.font)

    def _write_bar(self, bar: Bar) -> None:
        """The colour bar, on the right, as far in as its longest number needs."""
        longest = max(len(text) for _, text in bar.ticks)
        beside = _DIGIT * self.font * longest / self.size[0]
        table = pyvista.LookupTable(bar.colour_map, scalar_range=(bar.low, bar.top))
        plotter: Any = self.plotter  # whose decorated methods confuse type checkers
        shown = plotter.add_scalar_bar(
            title=bar.unit,
            lookup_table=table,
            unique_bar=True,
            vertical=True,
            n_labels=len(bar.ticks),
            fmt=_number_format((bar.top - bar.low) / (len(bar.ticks) - 1)),
            color=INK,
            position_x=min(0.84, 0.97 - beside),
            position_y=0.18,
            width=0.07,
            height=0.62,
            unconstrained_font_size=True,
        )
        for words in (shown.GetLabelTextProperty(), shown.GetTitleTextProperty()):
            _set_font(words, 0.9 * self.font)
        shown.SetVerticalTitleSeparation(self.font)

    def look(
        self,
        points: Float[np.ndarray, "point 3"],
        direction: tuple[float, float, float],
        margins: tuple[float, float, float, float],
    ) -> None:
        """Set a white background and a parallel camera that shows all points.

        Parameters
        ----------
        points : points to show [mm]
        direction : from the points to the camera
        margins : left, right, bottom and top parts of the panel that stay free
        """
        self.plotter.subplot(*self.place)
        self.renderer.set_background("white")
        left, right, bottom, top = margins
        width, height = self.size
        toward = np.array(direction) / np.linalg.norm(direction)
        across = np.cross([0.0, 0.0, 1.0], toward)
        across /= np.linalg.norm(across)
        frame = np.stack([across, np.cross(toward, across), toward])
        seen = points @ frame.T
        low, high = seen.min(axis=0), seen.max(axis=0)
        room = np.array([width * (1 - left - right), height * (1 - bottom - top)])
        scale = float(max((high - low)[:2] / room)) or 1.0  # mm per pixel
        shift = scale * np.array([width * (right - left), height * (top - bottom)]) / 2
        centre = np.append((low + high)[:2] / 2 + shift, (low + high)[2] / 2) @ frame
        camera = self.camera
        camera.parallel_projection = True
        camera.parallel_scale = scale * height / 2
        distance = 2.0 * float(np.linalg.norm(high - low)) or 1.0
        self.plotter.camera_position = [tuple(centre + distance * toward), tuple(centre), (0.0, 0.0, 1.0)]
        self.renderer.reset_camera_clipping_range()


def _set_font(words: Any, size: float) -> None:
    """A font that has more than Latin letters, `size` pixels high."""
    words.SetFontFamily(_FROM_FILE)
    words.SetFontFile(str(Path(get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")))
    words.SetFontSize(round(size))


def _number_format(step: float) -> str:
    """A format with as many decimals as multiples of `step` need."""
    digits = f"{step:.6f}".rstrip("0").partition(".")[2]
    return f"%.{len(digits)}f" if len(digits) < 6 else "%.3g"
