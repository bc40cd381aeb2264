"""Pixels that do not measure: dead ones read 0, hot ones are stuck at a level, in views, flats and darks alike.

Dead and hot pixels are drawn apart from each other, as exact parts of the panel; clusters are dead discs around drawn
centres; rows and columns are dead from end to end. The pattern belongs to the seed and is that of all channels. The
mask that goes with it has the bits of the field ``pixel_mask`` of NXdetector (NeXus definitions, NXdetector):
bit 1 dead, bit 3 over responding, and bit 6 in addition where a pixel is part of a cluster or line.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64, Shaped, UInt32

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

# Bits of a pixel mask, by NXdetector of NeXus: dead, over-responding, part of a cluster.
DEAD, HOT, CLUSTER = 1 << 1, 1 << 3, 1 << 6
# Largest part of the pixels that may be defective, no unit.
_MOST = 0.5

Image = Shaped[np.ndarray, "row column"]


@dataclass(frozen=True)
class Defects:
    """Pixels that do not measure.

    Parameters
    ----------
    dead, hot : parts of all pixels, at most a half each
    level : what hot pixels read, relative to the open beam of the channel at the panel's centre
    clusters, radius : number of dead discs, and their radius [pixel]
    rows, columns : indices of dead lines
    masked : whether the dataset says which pixels these are

    Raises
    ------
    InputError
        When a number is out of its range.
    """

    dead: float = 0.0
    hot: float = 0.0
    level: float = 2.0
    clusters: int = 0
    radius: float = 2.0
    rows: tuple[int, ...] = ()
    columns: tuple[int, ...] = ()
    masked: bool = True

    def __post_init__(self) -> None:
        for name in ("dead", "hot"):
            if not 0 <= getattr(self, name) <= _MOST:
                raise InputError(f"the part of {name} pixels must lie in 0 .. {_MOST}, got {getattr(self, name):g}")
        for name in ("level", "clusters", "radius"):
            if not 0 <= getattr(self, name) < np.inf:
                raise InputError(f"the {name} of defects must be finite and not negative, got {getattr(self, name):g}")

    def mask(self, seed: int, rows: int, columns: int) -> UInt32[np.ndarray, "row column"]:
        """Compute the bits that say what is wrong with each pixel; 0 is a good pixel.

        Parameters
        ----------
        seed : of the scan
        rows, columns : number of pixels

        Returns
        -------
        bits, (row, column)

        Raises
        ------
        InputError
            When a line lies outside the panel.
        """
        random = generator(seed, Stream.DEFECTS, 0, 0)
        mask = np.zeros((rows, columns), np.uint32)
        order = random.permutation(rows * columns)
        dead, hot = (round(part * mask.size) for part in (self.dead, self.hot))
        mask.flat[order[:dead]] = DEAD
        mask.flat[order[dead : dead + hot]] = HOT
        mask[self._discs(random, rows, columns) | self._lines(rows, columns)] = DEAD | CLUSTER
        return mask

    def _discs(self, random: np.random.RandomState, rows: int, columns: int) -> Bool[np.ndarray, "row column"]:
        """Pixels in clusters."""
        inside = np.zeros((rows, columns), bool)
        y, x = np.ogrid[:rows, :columns]
        for _ in range(self.clusters):
            row, column = random.random_sample(2) * (rows, columns) - 0.5
            inside |= (y - row) ** 2 + (x - column) ** 2 <= self.radius**2
        return inside

    def _lines(self, rows: int, columns: int) -> Bool[np.ndarray, "row column"]:
        """Pixels in dead rows and columns."""
        inside = np.zeros((rows, columns), bool)
        inside[_within("row", self.rows, rows)] = True
        inside[:, _within("column", self.columns, columns)] = True
        return inside


def stuck(image: Image, mask: UInt32[np.ndarray, "row column"], level: float) -> Image:
    """Set dead pixels of an image to 0, and hot ones to a level; the type of the values does not change.

    Parameters
    ----------
    image : readings, (row, column)
    mask : bits of each pixel
    level : reading of hot pixels

    Returns
    -------
    the image with defects
    """
    read = np.where(mask & DEAD, 0.0, level)
    return np.where(mask == 0, image, np.rint(read) if image.dtype.kind == "i" else read).astype(image.dtype)


def dead_or_hot(mask: UInt32[np.ndarray, "..."]) -> tuple[int, int]:
    """Count the dead and the hot pixels of a mask.

    Parameters
    ----------
    mask : bits of each pixel

    Returns
    -------
    number of dead and of hot pixels
    """
    return int(np.count_nonzero(mask & DEAD)), int(np.count_nonzero(mask & HOT))


def _within(what: str, lines: tuple[int, ...], count: int) -> Int64[np.ndarray, " line"]:
    """Lines that a panel has."""
    for line in lines:
        if not 0 <= line < count:
            raise InputError(f"there is no {what} {line} on a panel of {count} {what}s, counted from 0")
    return np.array(lines, dtype=np.int64)
