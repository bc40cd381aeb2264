"""Signals that vary slowly over a panel, such as scatter: known at few places of each view, splines between them."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class SmoothSignal:
    """Expected signal of every view at places from edge to edge of the panel.

    Parameters
    ----------
    values : signal per pixel of the panel, at exposure 1 and gain 1, in units of the counts

    Raises
    ------
    InputError
        When a value is not finite.
    """

    values: Float[np.ndarray, "view channel place_row place_column"]

    def __post_init__(self) -> None:
        if not np.isfinite(self.values).all():
            raise InputError("a smooth signal holds values that are not finite")

    def __len__(self) -> int:
        return len(self.values)

    def __getitem__(self, views: slice | list[int] | Int[np.ndarray, " few"]) -> "SmoothSignal":
        """Take some of the views."""
        return replace(self, values=self.values[views])

    def scaled(self, factors: Float[np.ndarray, " channel"]) -> "SmoothSignal":
        """Multiply the signal of each channel.

        Parameters
        ----------
        factors : one of each channel

        Returns
        -------
        the product
        """
        return replace(self, values=self.values * np.asarray(factors)[:, None, None])

    def image(self, view: int, rows: int, columns: int) -> Float[np.ndarray, "channel row column"]:
        """Interpolate the signal of a view.

        Parameters
        ----------
        view : number of the view
        rows, columns : number of pixels of the panel, or of blocks of them

        Returns
        -------
        signal per pixel at the centre of each pixel or block, not negative
        """
        down, across = (spline_weights(n, p) for n, p in zip((rows, columns), self.values.shape[2:], strict=True))
        found = np.einsum("ri,cij,kj->crk", down, self.values[view], across, optimize=True)
        return np.maximum(found, 0.0).astype(np.float32)


def spline_weights(count: int, places: int) -> Float[np.ndarray, "pixel place"]:
    """Compute spline weights from values at evenly spread places to values at the centres of pixels.

    Parameters
    ----------
    count : number of pixels in the line
    places : number of places, from edge to edge of the line

    Returns
    -------
    weights, (pixel, place)
    """
    from scipy.interpolate import make_interp_spline  # noqa: PLC0415 - slow to import, and seldom needed

    return make_interp_spline(line_places(count, places), np.eye(places), k=min(3, places - 1))(np.arange(count))


def line_places(count: int, places: int) -> Float[np.ndarray, " place"]:
    """Return places from the first to the last edge of a line of pixels.

    Parameters
    ----------
    count : number of pixels in the line
    places : number of places

    Returns
    -------
    places [pixel]
    """
    return np.linspace(-0.5, count - 0.5, places)
