"""Voxel phantoms of the ICRP become scenes: reference adults of Publication 110, and others in their format.

A phantom is a folder with three text files, NAME.dat, NAME_organs.dat and NAME_media.dat: numbers of organs voxel by
voxel, columns first, from the patient's right to the left, from front to back, and from the toes up; a medium and a
density for each organ; and percentages by mass of 13 elements for each medium. None of them is part of this project.

References
----------
ICRP 2009, Adult Reference Computational Phantoms, ICRP Publication 110, Ann. ICRP 39(2). ICRP 2020, Paediatric
Computational Reference Phantoms, ICRP Publication 143, Ann. ICRP 49(1).
"""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import UInt8

from phantomgen.importers.scene_text import BEAM, flow, nominal_scan
from phantomgen.runtime.disk import complete_file
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError

# Columns, rows, slices and edges of a voxel along them [mm], Table 3 of Publication 110.
_ADULTS = {"AM": ((254, 127, 222), (2.137, 2.137, 8.0)), "AF": ((299, 137, 348), (1.775, 1.775, 4.84))}
# Order of the percentages in a file of media.
_ELEMENTS = ("H", "C", "N", "O", "Na", "Mg", "P", "S", "Cl", "K", "Ca", "Fe", "I")
_ORGAN = re.compile(r"\s*(\d+)\s+(\S.*?)\s+(\d+)\s+(\d+(?:\.\d+)?)\s*")
_MEDIUM = re.compile(r"\s*(\d+)\s+(\S.*?)((?:\s+\d+(?:\.\d+)?){13})\s*")
_WHOLE = 3.0  # percent by which the elements of a medium may miss 100
_MOST_VOXELS = 200_000_000  # twenty times those of the largest phantom of Publication 110; bounds the memory
_LONGEST_LINE = 1000  # characters; longer lines are no rows of these tables
_VIEWS = 180


@dataclass(frozen=True)
class Organ:
    """An organ of a phantom.

    Parameters
    ----------
    name : as in the file
    medium : number of its medium
    density : [g/cm^3]
    """

    name: str
    medium: int
    density: float


@dataclass(frozen=True, eq=False)
class Phantom:
    """A voxel phantom.

    Parameters
    ----------
    name : of its files
    labels : organs, 0 outside, along x to the patient's right, y to the front, z to the head
    spacing : edges of a voxel along x, y and z [mm]
    organs : by their numbers
    media : name, and parts by mass of the elements, by number
    """

    name: str
    labels: UInt8[np.ndarray, "z y x"]
    spacing: tuple[float, float, float]
    organs: dict[int, Organ]
    media: dict[int, tuple[str, dict[str, float]]]


def read_phantom(folder: Path, shape: Sequence[int] | None = None, voxel: Sequence[float] | None = None) -> Phantom:
    """Read a phantom.

    Parameters
    ----------
    folder : with the files of one phantom
    shape : numbers of columns, rows and slices; known for AM and AF
    voxel : edges of a voxel along columns, rows and slices [mm]; known for AM and AF

    Returns
    -------
    the phantom

    Raises
    ------
    InputError
        When a file is missing or not in this format, or voxels have organs that the files do not name.
    """
    name = _name_of(folder)
    if shape is None or voxel is None:
        if name not in _ADULTS:
            raise InputError(
                f"{folder}: the size of {name} is not known here: give --shape COLUMNS,ROWS,SLICES and --voxel X,Y,Z "
                "in mm, as the publication states them"
            )
        shape, voxel = shape or _ADULTS[name][0], voxel or _ADULTS[name][1]
    columns, rows, slices = shape
    if columns * rows * slices > _MOST_VOXELS:
        raise InputError(f"{columns} x {rows} x {slices} voxels are too many: at most {_MOST_VOXELS} are read")
    organs, media = _organs(folder / f"{name}_organs.dat"), _media(folder / f"{name}_media.dat")
    numbers = _numbers(folder / f"{name}.dat", columns * rows * slices)
    unknown = set(np.unique(numbers).tolist()) - organs.keys() - {0}
    if unknown:
        raise InputError(f"{folder / name}.dat has organ {min(unknown)}, which {name}_organs.dat does not name")
    for number, organ in organs.items():
        if organ.medium not in media:
            raise InputError(f"{name}_organs.dat gives organ {number} medium {organ.medium}, which has no composition")
    labels = numbers.astype(np.uint8).reshape(slices, rows, columns)[:, ::-1, ::-1]
    return Phantom(name, labels, (float(voxel[0]), float(voxel[1]), float(voxel[2])), organs, media)


def write_scene(
    phantom: Phantom,
    out: Path,
    *,
    heights: tuple[float, float] | None = None,
    without: Sequence[str] = (),
    overwrite: bool = False,
) -> tuple[Path, Path]:
    """Write a scene of a phantom, or of a part of it, and the labels that it reads, with a nominal scan around it.

    Parameters
    ----------
    phantom : the phantom
    out : the scene; the labels lie beside it, with the ending ``-labels.npz``
    heights : lowest and highest slice that is used, above the soles [mm]; all where left out
    without : organs whose names hold one of these words are left out, such as ``arm``
    overwrite : replace files that exist

    Returns
    -------
    the scene and the labels

    Raises
    ------
    InputError
        When nothing is left, or a file exists.
    """
    beside = out.with_name(f"{out.stem}-labels.npz")
    for path in (out, beside):
        check_output(path, overwrite)
    low, high = _slices(phantom, heights)
    labels = phantom.labels[low:high]
    gone = [n for n, organ in phantom.organs.items() if any(word.lower() in organ.name.lower() for word in without)]
    labels = np.where(np.isin(labels, gone), np.uint8(0), labels)
    used = [int(number) for number in np.unique(labels) if number]
    if not used:
        raise InputError(f"no voxel of {phantom.name} is left: choose other heights, or leave out fewer organs")
    labels = _cropped(labels)
    names = _material_names(phantom, used)
    text = _text(phantom, out, beside, labels.shape, names, (low, high))
    with complete_file(out, ".yaml") as scene, complete_file(beside, ".npz") as array:
        np.savez_compressed(array, labels=labels)
        scene.write_text(text, encoding="utf-8")
    return out, beside


def _name_of(folder: Path) -> str:
    """Name of the phantom in a folder."""
    found = sorted(path.name.removesuffix("_organs.dat") for path in folder.glob("*_organs.dat"))
    if len(found) != 1:
        raise InputError(
            f"{folder} must be a folder with NAME.dat, NAME_organs.dat and NAME_media.dat of one phantom, such as AM "
            f"of ICRP Publication 110; it has {len(found)} files *_organs.dat"
        )
    return found[0]


def _lines(path: Path) -> list[str]:
    """Lines of a text file."""
    if not path.is_file():
        raise InputError(f"{path} is missing")
    return [line for line in path.read_text(encoding="latin-1").splitlines() if len(line) < _LONGEST_LINE]


def _organs(path: Path) -> dict[int, Organ]:
    """Organs by number."""
    rows = [found.groups() for line in _lines(path) if (found := _ORGAN.fullmatch(line))]
    if not rows:
        raise InputError(f"{path} has no line with the number of an organ, its name, its medium and its density")
    return {int(number): Organ(name, int(medium), float(density)) for number, name, medium, density in rows}


def _media(path: Path) -> dict[int, tuple[str, dict[str, float]]]:
    """Media by number."""
    found = {}
    for line in _lines(path):
        row = _MEDIUM.fullmatch(line)
        if row is None:
            continue
        parts = np.array(row[3].split(), dtype=float)
        if abs(parts.sum() - 100) > _WHOLE:
            raise InputError(f"{path}: the elements of {row[2]} sum to {parts.sum():g} %")
        parts = parts / parts.sum()
        found[int(row[1])] = (row[2], {e: float(f"{p:.6g}") for e, p in zip(_ELEMENTS, parts, strict=True) if p > 0})
    if not found:
        raise InputError(f"{path} has no line with the number of a medium, its name and 13 percentages by mass")
    return found


def _numbers(path: Path, count: int) -> np.ndarray:
    """Numbers of organs of all voxels."""
    if not path.is_file():
        raise InputError(f"{path} is missing")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of text that is no number, which the count notices
        found = np.fromfile(path, dtype=np.int64, sep=" ", count=count + 1)
    if len(found) != count:
        more = "more than " if len(found) > count else ""
        raise InputError(f"{path} has {more}{min(len(found), count)} numbers, where its voxels need {count}")
    if found.min() < 0 or found.max() > np.iinfo(np.uint8).max:
        raise InputError(f"{path} has numbers from {found.min()} to {found.max()}: organs have numbers from 0 to 255")
    return found


def _slices(phantom: Phantom, heights: tuple[float, float] | None) -> tuple[int, int]:
    """First slice, and the one after the last, whose middles lie between two heights."""
    slices, edge = len(phantom.labels), phantom.spacing[2]
    if heights is None:
        return 0, slices
    middles = (np.arange(slices) + 0.5) * edge
    inside = np.flatnonzero((middles >= heights[0]) & (middles < heights[1]))
    if not len(inside):
        raise InputError(
            f"{phantom.name} is {slices * edge:g} mm high: there is no slice from {heights[0]:g} to {heights[1]:g} mm"
        )
    return int(inside[0]), int(inside[-1]) + 1


def _cropped(labels: UInt8[np.ndarray, "z y x"]) -> UInt8[np.ndarray, "z y_left x_left"]:
    """The box that holds all organs, in x and y."""
    rows, columns = (np.flatnonzero(labels.any(axis=axes)) for axes in ((0, 2), (0, 1)))
    return labels[:, rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]


def _material_names(phantom: Phantom, used: Sequence[int]) -> dict[int, str]:
    """A name of the material of each organ; organs of one medium and one density share it."""
    kinds = {number: (phantom.organs[number].medium, phantom.organs[number].density) for number in used}
    names = {}
    for number, (medium, density) in kinds.items():
        plain = re.sub(r"[^a-z0-9]+", "_", phantom.media[medium][0].lower()).strip("_") or f"medium_{medium}"
        alone = all(other == (medium, density) or other[0] != medium for other in kinds.values())
        names[number] = plain if alone else f"{plain}_{density:g}"
    return names


def _text(
    phantom: Phantom,
    out: Path,
    beside: Path,
    shape: Sequence[int],
    names: dict[int, str],
    slices: tuple[int, int],
) -> str:
    """The scene."""
    materials = {
        name: {"composition": phantom.media[organ.medium][1], "density": organ.density}
        for name, organ in ((name, phantom.organs[number]) for number, name in names.items())
    }
    extent = [count * edge for count, edge in zip(shape[::-1], phantom.spacing, strict=True)]
    radius = float(np.hypot(extent[0], extent[1])) / 2
    title = re.sub(r"[^A-Za-z0-9._-]+", "-", out.stem).lstrip("._-") or phantom.name
    organs = "\n".join(f"      {number}: {name} # {phantom.organs[number].name}" for number, name in names.items())
    return (
        f"# {phantom.name} of the ICRP, slices {slices[0]} to {slices[1] - 1} from the soles up. Source, panel and "
        f"distances are nominal.\nversion: 1\nname: {title}\n\n{BEAM}"
        f"{nominal_scan(radius, extent[2] / 2, max(extent) / 2, _VIEWS)}\nmaterials:\n"
        + "".join(f"  {name}: {flow(value)}\n" for name, value in materials.items())
        + f"\nobjects:\n  - type: voxels\n    file: {flow(f'{beside.name}:labels')}\n"
        f"    spacing: {list(phantom.spacing)}\n    labels:\n{organs}\n"
    )
