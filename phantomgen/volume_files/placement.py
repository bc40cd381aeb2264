"""Where the voxels of an array lie in a scan: by what a file says, and by what a user states where it does not."""

import re
from dataclasses import dataclass
from math import degrees
from typing import Literal

import numpy as np
from jaxtyping import Shaped

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.images import FROM_ITK
from phantomgen.volume_files.volume import Triple, Volume
from spectra.errors import InputError

_SIZES, _PLACES = (1e-6, 1e6), (-1e9, 1e9)  # mm; other numbers are not those of a scan
_TURNED = 1e-3  # rad; axes that are turned by more are not those of the scan; less is rounding of headers
CENTER, COORDINATES = "center", ("header", "scan")


@dataclass(frozen=True)
class Placement:
    """What a user states about the place of an array; None is taken from the file.

    Parameters
    ----------
    axes : axis of the scan along each axis of the array, such as ``zyx``; a minus before a letter where the index grows
        against the axis, a ``c`` for the axis of several parts
    voxel : size of a voxel along (z, y, x) of the scan [mm]
    origin : centre of the first voxel of the array (z, y, x) [mm], or ``center`` for a volume around the isocentre
    grid : grid that the volume has, in place of the two
    coordinates : ``header`` to convert left and back (LPS) of images to right and front, ``scan`` for images whose
        coordinates are those of the scan
    """

    axes: str | None = None
    voxel: Triple | None = None
    origin: Triple | Literal["center"] | None = None
    grid: Grid | None = None
    coordinates: Literal["header", "scan"] = "header"

    def __post_init__(self) -> None:
        if self.axes is not None:
            parse_axes(self.axes)
        if self.voxel is not None:
            _check_place("--voxel-mm", "a size", self.voxel, _SIZES)
        if self.grid is not None and (self.voxel is not None or self.origin is not None):
            raise InputError("--same-grid states size and place of the voxels: leave --voxel-mm and --origin-mm out")

    def missing(self, volume: Volume) -> list[str]:
        """List the options that the file makes necessary.

        Parameters
        ----------
        volume : as read from the file

        Returns
        -------
        names of options
        """
        options = []
        if self.axes is None and volume.directions is None:
            options.append("--axes")
        if self.grid is None and self.voxel is None and volume.spacing is None:
            options.append("--voxel-mm")
        if self.grid is None and self.origin is None and volume.origin is None:
            options.append("--origin-mm")
        return options


def placed(name: str, volume: Volume, stated: Placement) -> tuple[Shaped[np.ndarray, "part z y x"], Grid]:
    """Order the axes of an array as those of the scan, and find its grid; values are not changed.

    Parameters
    ----------
    name : of the volume, for messages
    volume : as read from the file
    stated : what the user states; with the file it must say all

    Returns
    -------
    the array, all axes ascending, and the grid of its voxels

    Raises
    ------
    InputError
        When the axes of the file are turned against those of the scan, or statements do not fit the array.
    """
    axes = parse_axes(stated.axes) if stated.axes is not None else _axes_of(name, volume, stated.coordinates)
    letters = [letter for letter, _ in axes]
    if len(axes) == 3 and volume.values.ndim == 4:
        axes, letters = [("c", 1), *axes], ["c", *letters]
    if len(axes) != volume.values.ndim:
        shape = " x ".join(map(str, volume.values.shape))
        raise InputError(f"{name} has {volume.values.ndim} axes ({shape}), --axes names {len(axes)}")
    values = volume.values if "c" in letters else volume.values[None]
    order = [letters.index(axis) + ("c" not in letters) for axis in "zyx"]
    values = np.moveaxis(values, [letters.index("c") if "c" in letters else 0, *order], (0, 1, 2, 3))
    signs = [dict(axes)[axis] for axis in "zyx"]
    values = values[:, *(slice(None, None, sign) for sign in signs)]
    shape = (values.shape[1], values.shape[2], values.shape[3])
    if stated.grid is not None:
        if stated.grid.shape != shape:
            own, wanted = (" x ".join(map(str, each)) for each in (shape, stated.grid.shape))
            raise InputError(
                f"{name} has {own} voxels (z, y, x), the grid of the dataset has {wanted}: "
                "state --voxel-mm and --origin-mm in place of --same-grid"
            )
        return values, stated.grid
    space = [letter for letter in letters if letter != "c"]
    spacing = stated.voxel or _spacing(volume, space)
    _check_place(name, "the size of a voxel", spacing, _SIZES)
    if stated.origin == CENTER:
        first = tuple((1 - n) / 2 * step for n, step in zip(shape, spacing, strict=True))
    else:
        begin = stated.origin if stated.origin is not None else _origin(volume, stated.coordinates)
        _check_place(name, "the centre of the first voxel", begin, _PLACES)
        ends = zip(begin, signs, shape, spacing, strict=True)
        first = tuple(start - (sign < 0) * (n - 1) * step for start, sign, n, step in ends)
    return values, Grid(shape, spacing, first)  # type: ignore[arg-type]


def parse_axes(text: str) -> list[tuple[str, int]]:
    """Read the axes of an array.

    Parameters
    ----------
    text : such as ``zyx``, ``xyz``, ``z-yx`` or ``czyx``

    Returns
    -------
    letter and sign of each axis

    Raises
    ------
    InputError
        When x, y and z do not occur once each.
    """
    found = re.findall(r"(-?)([a-z])", text.lower())
    letters = [letter for _, letter in found]
    if "".join(sign + letter for sign, letter in found) != text.lower() or sorted(set(letters) - {"c"}) != [*"xyz"]:
        found = []
    if not found or len(letters) != len(set(letters)) or ("-", "c") in found:
        raise InputError(
            "--axes names the axis of the scan along each axis of the array, such as zyx, xyz, z-yx or czyx, "
            f"got {text!r}"
        )
    return [(letter, -1 if sign else 1) for sign, letter in found]


def _axes_of(name: str, volume: Volume, coordinates: str) -> list[tuple[str, int]]:
    """Axes from the directions of a file, slowest axis of the array first."""
    directions = np.eye(3) if volume.directions is None else volume.directions
    directions = FROM_ITK @ directions if coordinates == "scan" else directions
    found = np.abs(directions).argmax(axis=0)
    largest = np.abs(directions).max(axis=0) / np.linalg.norm(directions, axis=0)
    turned = float(np.arccos(np.clip(largest.min(), -1, 1)))
    if turned > _TURNED or len(set(found.tolist())) < 3:
        raise InputError(
            f"{name}: its axes are turned against those of the scan by {degrees(turned):.3g} degrees: resample it to "
            "axes that are parallel to x, y and z first"
        )
    return [("xyz"[found[i]], 1 if directions[found[i], i] > 0 else -1) for i in (2, 1, 0)]


def _check_place(name: str, what: str, numbers: Triple, limits: tuple[float, float]) -> None:
    """Refuse what a damaged header may hold."""
    low, high = limits
    if not all(low <= number <= high for number in numbers):
        text = ", ".join(f"{number:g}" for number in numbers)
        raise InputError(f"{name}: {what} must be from {low:g} to {high:g} mm, got {text} (z, y, x)")


def _spacing(volume: Volume, letters: list[str]) -> Triple:
    """Size of voxels along (z, y, x) of the scan from that along the axes of the array."""
    along = dict(zip(letters, (volume.spacing or (0.0, 0.0, 0.0))[::-1], strict=True))
    return along["z"], along["y"], along["x"]


def _origin(volume: Volume, coordinates: str) -> Triple:
    """Centre of the first voxel (z, y, x)."""
    point = np.array(volume.origin, dtype=np.float64)
    x, y, z = (float(value) for value in (FROM_ITK @ point if coordinates == "scan" else point))
    return z, y, x
