"""What every panel of a window shares: its place, its fonts, its legend and its camera."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista
from jaxtyping import Float

INK, MUTED, FAINT = "#222222", "#666666", "#b4b4b4"
FONT = 17  # pixels in a window of 1600 x 1000
_LINE = 1.7  # height of a line of text, in font sizes


@dataclass(frozen=True, eq=False)
class Pane:
    """One panel of a window.

    Parameters
    ----------
    plotter : the window
    place : row and column of the panel's first cell
    font : height of letters [pixel]
    """

    plotter: pyvista.Plotter
    place: tuple[int, int]
    font: int

    def activate(self) -> None:
        """What is added to the window from now on goes here."""
        self.plotter.subplot(*self.place)

    @property
    def size(self) -> tuple[float, float]:
        """Width and height [pixel]."""
        x0, y0, x1, y1 = self.plotter.renderer.viewport
        width, height = self.plotter.window_size
        return (x1 - x0) * width, (y1 - y0) * height

    def title(self, text: str) -> None:
        """A line on top."""
        width, height = self.size
        self.text(text, self.font / width, 1 - 2 * self.font / height, round(1.15 * self.font))

    def text(self, text: str, x: float, y: float, font: int, colour: str = INK) -> None:
        """A line that starts at (x, y), in parts of the panel."""
        shown = self.plotter.add_text(text, position=(x, y), viewport=True, color=colour)
        shown.prop.SetFontFamily(4)  # of a file
        shown.prop.SetFontFile(font_file())
        shown.prop.SetFontSize(font)

    def legend(self, keys: list[tuple[str, str]]) -> None:
        """Names with their colours, at the lower left."""
        width, height = self.size
        for i, (name, colour) in enumerate(reversed(keys)):
            y = (1 + i * _LINE) * self.font / height
            self.text("\N{BLACK SQUARE}", self.font / width, y, self.font, colour)
            self.text(name, 2.4 * self.font / width, y, self.font)

    def note(self, text: str) -> None:
        """A small line at the lower left."""
        width, height = self.size
        self.text(text, self.font / width, self.font / height, round(0.9 * self.font), MUTED)

    def colour_bar(self, mapper: pyvista.DataSetMapper, top: float, ticks: int) -> None:
        """A bar from 0 to `top` on the right, in 1/mm."""
        bar = self.plotter.add_scalar_bar(
            title="1/mm",
            mapper=mapper,
            unique_bar=True,
            vertical=True,
            n_labels=ticks,
            fmt=_number_format(top / (ticks - 1)),
            color=INK,
            position_x=0.84,
            position_y=0.18,
            width=0.07,
            height=0.62,
            unconstrained_font_size=True,
        )
        for words in (bar.GetLabelTextProperty(), bar.GetTitleTextProperty()):
            words.SetFontFamily(4)
            words.SetFontFile(font_file())
            words.SetFontSize(round(0.9 * self.font))
        bar.SetVerticalTitleSeparation(self.font)

    def look(
        self,
        points: Float[np.ndarray, "point 3"],
        direction: tuple[float, float, float],
        margins: tuple[float, float, float, float],
    ) -> None:
        """White, with axes, and a parallel camera that sees all points.

        Parameters
        ----------
        points : to be seen [mm]
        direction : from the points to the camera
        margins : left, right, bottom and top parts of the panel that stay free
        """
        self.plotter.set_background("white")
        self.plotter.add_axes(color=INK, line_width=2, viewport=(0.86, 0.0, 1.0, 0.16))
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
        camera = self.plotter.camera
        camera.parallel_projection = True
        camera.parallel_scale = scale * height / 2
        distance = 2.0 * float(np.linalg.norm(high - low)) or 1.0
        self.plotter.camera_position = [tuple(centre + distance * toward), tuple(centre), (0.0, 0.0, 1.0)]
        self.plotter.renderer.reset_camera_clipping_range()


def _number_format(step: float) -> str:
    """A format with as many decimals as multiples of `step` need."""
    digits = f"{step:.6f}".rstrip("0").partition(".")[2]
    return f"%.{len(digits)}f" if len(digits) < 6 else "%.3g"


def font_file() -> str:
    """A font that has more than Latin letters."""
    import matplotlib  # noqa: PLC0415

    return str(Path(matplotlib.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf"))
