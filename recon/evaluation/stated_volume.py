"""A volume of any program as a model of a scan: what it holds, where it lies, and what looks wrong about it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import permutations, product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.true_materials import read_true_materials
from phantomgen.dataset.truth import Truth
from phantomgen.geometry.voxel_grid import Grid, parse_triple
from phantomgen.ops.box_average import box_average, covered_part
from phantomgen.volume_files.placement import CENTER, COORDINATES, Placement, placed
from phantomgen.volume_files.read import read_volume
from phantomgen.volume_files.volume import Volume, checked
from recon.evaluation.quantities import KINDS, Quantities, Quantity, parse_quantities, with_truth
from recon.voxel.model import Voxels
from spectra.errors import DatasetError, InputError

# Parts of the mean square error that another orientation, or another unit, must leave for a remark; our choice.
_TURNED_LEAVES, _SCALED_LEAVES = 0.8, 0.5
_ROUNDING = 1e-6  # part of the square of the truth; errors below it are those of float32
_SAMPLES = 64  # voxels along an axis that orientations are compared on
_FACTORS = (1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3)  # between the units that people confuse
_LARGEST = 1e30  # [1/mm] or [g/cm^3]; beyond this squares do not fit into float32
_RUN_VOLUMES = "volumes.h5"
OPTIONS = ("as", "units", "axes", "voxel-mm", "origin-mm", "same-grid", "coordinates")  # of recon score


@dataclass(frozen=True)
class Statement:
    """What a user states about volumes.

    Parameters
    ----------
    quantities : what each part holds, see `recon.evaluation.quantities.parse_quantities`; None for basis volumes whose
        names are in the file
    units : of the values; None where the file says
    place : of the voxels
    """

    quantities: tuple[Quantity, ...] | None = None
    units: str | None = None
    place: Placement = field(default_factory=Placement)

    @classmethod
    def of(cls, options: Mapping[str, Any], grid: Grid) -> "Statement":
        """Read a statement from the options of a command.

        Parameters
        ----------
        options : texts by the name of the option, see `OPTIONS`; those that were not given are left out or None
        grid : of the dataset, for ``same-grid``

        Returns
        -------
        the statement

        Raises
        ------
        InputError
            When an option is unknown, or its text cannot be read.
        """
        for name in options:
            if name not in OPTIONS:
                raise InputError(f"there is no statement {name!r} about a volume: choose from {', '.join(OPTIONS)}")
        texts = options.get("as") or ()
        each = [parse_quantities(text) for text in ([texts] if isinstance(texts, str) else texts)]
        voxel, origin = options.get("voxel-mm"), options.get("origin-mm")
        if origin is not None and origin != CENTER:
            origin = parse_triple("--origin-mm", origin, several=True)
        coordinates = options.get("coordinates") or COORDINATES[0]
        if coordinates not in COORDINATES:
            raise InputError(f"--coordinates are {' or '.join(COORDINATES)}, got {coordinates!r}")
        place = Placement(
            options.get("axes"),
            None if voxel is None else parse_triple("--voxel-mm", voxel),
            origin,
            grid if options.get("same-grid") else None,
            coordinates,  # type: ignore[arg-type] - one of the two
        )
        return cls(tuple(q for one in each for q in one) or None, options.get("units"), place)


class MeanVoxels(Voxels):
    """Volumes whose values on another grid are means over its voxels."""

    def volume(self, grid: Grid) -> Float[np.ndarray, "basis z y x"]:
        """Compute means over the voxels of a grid.

        Parameters
        ----------
        grid : any grid

        Returns
        -------
        exact means of what is constant in each voxel of the model, 0 outside of it
        """
        if grid == self.grid:
            return self.values
        return np.stack([box_average(one.astype(np.float64), self.grid, grid) for one in self.values]).astype(
            np.float32
        )


@dataclass(frozen=True, eq=False)
class StatedVolume:
    """Volumes in the unit of their truth.

    Parameters
    ----------
    model : the volumes, on their own grid
    quantities : what they hold, and the truth of it
    record : what was read and what was stated, for ``metrics.json``
    complete : whether they are basis volumes that predict counts: all of the dataset, or those of a run
    """

    model: MeanVoxels
    quantities: Quantities
    record: dict[str, Any]
    complete: bool

    def remarks(self) -> list[str]:
        """List what looks wrong about place, orientation and unit, by comparison with the truth; scores stay.

        Returns
        -------
        sentences
        """
        truth = self.quantities.truth
        found = [] if self.record["covered"] > 1 - 1e-4 else [_covered_sentence(self.record["covered"])]
        volumes = self.model.volume(truth.grid)
        turned = better_orientation(volumes, truth.volumes)
        if turned is not None:
            volumes = turned.volumes
            found.append(
                f"{turned.words}, the mean square error would be {100 * turned.gain:.0f} % smaller: check --axes, and "
                "--coordinates of images in patient coordinates"
            )
        scales = [better_factor(volume, true) for volume, true in zip(volumes, truth.volumes, strict=True)]
        if scales[0] is not None and len(set(scales)) == 1:
            found.append(f"multiplied by {scales[0]:g}, the error would be smaller by far: check --units")
        return found


def stated_volume(
    sources: Sequence[str | np.ndarray], stated: Statement, dataset: Dataset, truth: Truth | None
) -> StatedVolume:
    """Read volumes and put them beside their truth.

    Parameters
    ----------
    sources : files, run folders or arrays
    stated : what the user states
    dataset : the scan
    truth : of the dataset

    Returns
    -------
    the volumes

    Raises
    ------
    InputError
        When a file cannot be read, neither it nor the user say what is necessary, or a statement does not fit.
    DatasetError
        When the dataset holds no truth.
    """
    if truth is None:
        raise DatasetError(f"{dataset.path} holds no truth to score against")
    read = [_read(source) for source in sources]
    for name, volume in read:
        refuse_silent(name, volume, stated)
    read, each, from_run = _with_quantities(read, stated)
    order = _order(each, dataset.spectra.basis.names)
    materials = read_true_materials(dataset.path) if any(q.kind in ("density", "fraction") for q in each) else ()
    given = with_truth(each, truth, dataset.spectra, materials)
    parts, grid = [], None
    for name, volume in read:
        values, own = placed(name, volume, stated.place)
        if grid is not None and not _same(grid, own):
            raise InputError(f"{name} has other voxels than {read[0][0]}: score them one by one")
        grid = grid or own
        for one in values:
            parts.append(_converted(given, one, len(parts), stated.units or volume.units, name))
    assert grid is not None
    covered = covered_part(grid, truth.grid)
    if covered <= 0:
        raise InputError(f"{read[0][0]} lies outside the truth of {dataset.path}: check --voxel-mm and --origin-mm")
    quantities = with_truth([each[i] for i in order], truth, dataset.spectra, materials)
    model = MeanVoxels(np.stack([parts[i] for i in order]), grid, quantities.truth.basis_names)
    record = {
        "files": [name for name, _ in read],
        "as": [str(quantity) for quantity in each],
        "units": [stated.units or volume.units or "HU" for _, volume in read],
        "shape": list(grid.shape),
        "voxel_mm": list(grid.spacing),
        "origin_mm": list(grid.origin),
        "axes": stated.place.axes or "of the file",
        "covered": covered,
    }
    if quantities.group == "attenuation":
        record["energy_keV"] = list(quantities.energies)
    if any(quantities.water):
        record["water_per_mm"] = list(quantities.water)
    names = model.basis_names
    complete = quantities.group == "basis" and (from_run or set(names) == set(dataset.spectra.basis.names))
    return StatedVolume(model, quantities, record, complete)


@dataclass(frozen=True, eq=False)
class Orientation:
    """Another orientation of volumes.

    Parameters
    ----------
    words : what would have to be done
    volumes : the volumes after that
    gain : part of the mean square error that it takes away, after the best scalar
    """

    words: str
    volumes: Float[np.ndarray, "part z y x"]
    gain: float


def better_orientation(
    volumes: Float[np.ndarray, "part z y x"], truth: Float[np.ndarray, "part z y x"]
) -> Orientation | None:
    """Find out whether another orientation fits the truth far better, as a wrong order of axes makes it.

    Parameters
    ----------
    volumes, truth : on one grid

    Returns
    -------
    the orientation; None where none takes away a fifth of the mean square error after the best scalar of each part,
    and half of that of volumes of zeros
    """
    step = tuple(slice(None, None, max(n // _SAMPLES, 1)) for n in truth.shape[1:])
    true = np.asarray(truth[:, *step], dtype=np.float64)
    found: dict[tuple, tuple[float, np.ndarray]] = {}
    for order in permutations((1, 2, 3)):
        turned = volumes.transpose(0, *order)
        if turned.shape != truth.shape:
            continue
        for signs in product((1, -1), repeat=3):
            flipped = turned[:, *(slice(None, None, sign) for sign in signs)]
            found[order, signs] = _error_after_scalar(flipped[:, *step], true), flipped
    as_it_is = found[(1, 2, 3), (1, 1, 1)][0]
    if as_it_is < _ROUNDING * len(truth):
        return None
    (order, signs), (least, best) = min(found.items(), key=lambda pair: pair[1][0])
    if not least < min(_TURNED_LEAVES * as_it_is, _SCALED_LEAVES * len(truth)):  # zeros leave len(truth)
        return None
    mirrored = [axis for axis, sign in zip("zyx", signs, strict=True) if sign < 0]
    words = ["with the axes " + "".join("zyx"[i - 1] for i in order) + " in place of zyx"] if order != (1, 2, 3) else []
    words += [f"mirrored along {' and '.join(mirrored)}"] if mirrored else []
    return Orientation(" and ".join(words), best, 1 - least / as_it_is)


def _error_after_scalar(volumes: np.ndarray, truth: np.ndarray) -> float:
    """Sum over the parts of the relative square error that the best scalar leaves."""
    total = 0.0
    for volume, true in zip(volumes.astype(np.float64), truth, strict=True):
        norms, overlap = np.vdot(volume, volume) * np.vdot(true, true), np.vdot(volume, true)
        total += 1.0 - float(max(overlap, 0.0) ** 2 / norms) if norms > 0 else 1.0
    return total


def better_factor(volume: Float[np.ndarray, "z y x"], truth: Float[np.ndarray, "z y x"]) -> float | None:
    """Find out whether another unit fits the truth far better.

    Parameters
    ----------
    volume, truth : on one grid

    Returns
    -------
    a power of ten; None where the best scalar is near none, or leaves more than half of the mean square error or of
    that of a volume of zeros
    """
    v, t = np.asarray(volume, np.float64), np.asarray(truth, np.float64)
    energy = float(np.vdot(v, v))
    scale = float(np.vdot(v, t)) / energy if energy > 0 else 1.0
    near = [factor for factor in _FACTORS if 0.5 < scale / factor < 2]
    left, zeros = float(np.mean((scale * v - t) ** 2)), float(np.mean(t**2))
    return near[0] if near and left < _SCALED_LEAVES * min(float(np.mean((v - t) ** 2)), zeros) else None


def _read(source: str | np.ndarray) -> tuple[str, Volume]:
    """Name and content of a volume."""
    if isinstance(source, str):
        run = Path(source) / _RUN_VOLUMES
        return source, read_volume(str(run) if run.is_file() else source)
    return "the array", Volume(checked("the array", np.asarray(source)))


def _with_quantities(
    read: list[tuple[str, Volume]], stated: Statement
) -> tuple[list[tuple[str, Volume]], tuple[Quantity, ...], bool]:
    """Volumes, what their parts hold, and whether the file says so; parts that are not asked for are left out."""
    names = [volume.names for _, volume in read]
    if stated.quantities is None:
        return read, tuple(Quantity("basis", item) for each in names for item in each), True
    asked = [quantity.item for quantity in stated.quantities]
    if len(read) == 1 and names[0] and {q.kind for q in stated.quantities} == {"basis"} and set(asked) <= set(names[0]):
        (name, volume), known = read[0], names[0]
        if len(known) > 1:
            picked = Volume(volume.values[[known.index(item) for item in asked]], *_place(volume), tuple(asked))
            return [(name, picked)], stated.quantities, False
    count = sum(1 if volume.values.ndim == 3 else _parts(volume, stated.place) for _, volume in read)
    if count != len(asked):
        shapes = " and ".join(" x ".join(map(str, volume.values.shape)) for _, volume in read)
        raise InputError(
            f"{' and '.join(name for name, _ in read)} ({shapes}) must hold one volume per quantity: "
            f"--as names {len(asked)}, there are {count}"
        )
    return read, stated.quantities, False


def refuse_silent(name: str, volume: Volume, stated: Statement) -> None:
    """Refuse a volume about which neither its file nor the user say all.

    Parameters
    ----------
    name : of the volume, for the message
    volume : as read
    stated : what the user states

    Raises
    ------
    InputError
        When something is missing.
    """
    missing = [] if volume.names or stated.quantities is not None else [f"--as ({KINDS})"]
    missing += stated.place.missing(volume)
    known = stated.quantities is not None and all(quantity.kind == "hu" for quantity in stated.quantities)
    if not known and stated.units is None and volume.units is None:
        missing.append("--units")
    if missing:
        raise InputError(f"{name} does not say all that a score needs: state {_options(missing)}")


def _order(each: Sequence[Quantity], names: Sequence[str]) -> list[int]:
    """Basis volumes in the order of the dataset, other ones as they are."""
    place = {name: i for i, name in enumerate(names)}
    return sorted(range(len(each)), key=lambda i: place.get(each[i].item, 0) if each[i].kind == "basis" else i)


def _parts(volume: Volume, place: Placement) -> int:
    """Number of parts of an array with four axes."""
    axes = (place.axes or "czyx").replace("-", "")
    return volume.values.shape[axes.index("c") if "c" in axes and len(axes) == 4 else 0]


def _place(volume: Volume) -> tuple[Any, Any, Any, str | None]:
    return volume.spacing, volume.directions, volume.origin, volume.units


def _converted(
    quantities: Quantities, values: np.ndarray, part: int, unit: str | None, name: str
) -> Float[np.ndarray, "z y x"]:
    """Values of a part in the unit of the truth."""
    found = quantities.converted(values, part, unit, name)
    worst = float(np.abs(found).max())
    if worst > _LARGEST:
        raise InputError(
            f"{name}: values up to {worst:.3g} {quantities.unit} are no {quantities.group}: check the file"
        )
    return found.astype(np.float32)


def _same(one: Grid, other: Grid) -> bool:
    """Whether two grids agree to the rounding of headers."""
    close = (
        np.allclose(a, b, rtol=1e-5, atol=1e-4) for a, b in ((one.spacing, other.spacing), (one.origin, other.origin))
    )
    return one.shape == other.shape and all(close)


def _options(missing: list[str]) -> str:
    """Names of options as a list in words."""
    names = [
        f"{name} (or --same-grid where its voxels are those of the dataset)" if name == "--origin-mm" else name
        for name in missing
    ]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _covered_sentence(covered: float) -> str:
    return f"the volume covers {100 * covered:.3g} % of the grid of the truth; the rest counts as 0"
