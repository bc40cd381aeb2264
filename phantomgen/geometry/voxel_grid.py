"""The voxel grid of a volume."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError


@dataclass(frozen=True)
class Grid:
    """Regular grid of voxels, every triple in array order (z, y, x).

    Parameters
    ----------
    shape : number of voxels
    spacing : distance between voxel centres [mm]
    origin : centre of voxel (0, 0, 0) [mm]
    """

    shape: tuple[int, int, int]
    spacing: tuple[float, float, float]
    origin: tuple[float, float, float]

    def __post_init__(self) -> None:
        if not len(self.shape) == len(self.spacing) == len(self.origin) == 3:
            raise InputError(
                f"a grid needs three numbers each, got shape {self.shape}, spacing {self.spacing}, origin {self.origin}"
            )
        if not all(float(n).is_integer() for n in self.shape):
            raise InputError(f"the shape of a grid must be whole numbers, got {self.shape}")
        if not np.isfinite([*self.spacing, *self.origin]).all():
            raise InputError(f"spacing and origin of a grid must be numbers, got {self.spacing} and {self.origin} mm")
        if min(self.shape) < 1:
            raise InputError(f"a grid needs at least one voxel along each axis, got shape {self.shape}")
        if min(self.spacing) <= 0:
            raise InputError(f"the voxel spacing must be positive, got {self.spacing} mm")

    @classmethod
    def cube(cls, voxels: int, size: float) -> "Grid":
        """Create a cube centred on the isocentre.

        Parameters
        ----------
        voxels : number along each edge
        size : edge length [mm]

        Returns
        -------
        the grid
        """
        spacing = size / voxels
        first = (spacing - size) / 2
        return cls((voxels, voxels, voxels), (spacing, spacing, spacing), (first, first, first))

    def slices(self, first: int, count: int) -> "Grid":
        """Return the part of the grid that begins with slice `first`.

        Parameters
        ----------
        first : index of the first slice
        count : number of slices

        Returns
        -------
        the part
        """
        return self.part((slice(first, first + count), slice(None), slice(None)))

    def part(self, box: tuple[slice, slice, slice]) -> "Grid":
        """Return the voxels of a box of the array (z, y, x).

        Parameters
        ----------
        box : slices along z, y and x

        Returns
        -------
        the part
        """
        ranges = [range(n)[one] for n, one in zip(self.shape, box, strict=True)]
        shape = tuple(len(r) for r in ranges)
        origin = tuple(o + r.start * s for o, r, s in zip(self.origin, ranges, self.spacing, strict=True))
        return Grid(shape, self.spacing, origin)  # type: ignore[arg-type]

    @property
    def voxel_volume(self) -> float:
        """Volume of one voxel [mm^3]."""
        return float(np.prod(self.spacing))

    def axis(self, name: str) -> Float[np.ndarray, " voxel"]:
        """Return the voxel centres along an axis.

        Parameters
        ----------
        name : ``"x"``, ``"y"`` or ``"z"``

        Returns
        -------
        positions [mm]
        """
        i = "zyx".index(name)
        return self.origin[i] + self.spacing[i] * np.arange(self.shape[i])

    @property
    def affine(self) -> Float[np.ndarray, "4 4"]:
        """Matrix from (x, y, z) voxel index to (x, y, z) position [mm]."""
        matrix = np.diag([*self.spacing[::-1], 1.0])
        matrix[:3, 3] = self.origin[::-1]
        return matrix


def parse_triple(option: str, text: str, several: bool = False) -> tuple[float, float, float]:
    """Read numbers along (z, y, x) from the text of an option.

    Parameters
    ----------
    option : its name, for the message
    text : three numbers with commas between, or one for all axes
    several : whether one number is refused

    Returns
    -------
    the numbers

    Raises
    ------
    InputError
        When the text is something else.
    """
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) == 1 and not several:
        numbers *= 3
    if len(numbers) != 3 or not np.isfinite(numbers).all():
        wanted = "three numbers z,y,x" if several else "one number, or three: z,y,x"
        raise InputError(f"{option} needs {wanted}, got {text!r}")
    return numbers[0], numbers[1], numbers[2]
