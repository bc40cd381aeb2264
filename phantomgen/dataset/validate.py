"""Checks of a dataset that require reading all of it; `open_dataset` makes the quick ones."""

from collections.abc import Callable, Iterator
from itertools import combinations
from pathlib import Path

import numpy as np

from phantomgen.dataset.checks.counts import check_counts
from phantomgen.dataset.checks.digest import chunk_problems, seal_problems
from phantomgen.dataset.checks.door import find_array, frame_at, outside_problems
from phantomgen.dataset.checks.fields import ENTRY, form_problems, value_problems
from phantomgen.dataset.file import DARK, DETECTOR, FLAT, open_file
from phantomgen.dataset.geometry import KINDS
from phantomgen.dataset.layout import SCHEMA_VERSION
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.true_poses import read_true_geometry
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.geometry.poses import Geometry
from spectra.errors import DatasetError, Error

_SIGNALS = ("counts", "keV")
_UNITS = {
    f"{DETECTOR}/x_pixel_size": "mm",
    f"{DETECTOR}/y_pixel_size": "mm",
    f"{DETECTOR}/distance": "mm",
    "/entry/sample/rotation_angle": "degree",
    "/entry/geometry/panel_center": "mm",
    "/entry/geometry/column_step": "mm",
    "/entry/geometry/row_step": "mm",
    "/entry/spectra/energy": "keV",
    "/entry/spectra/energy_edges": "keV",
    "/entry/reconstruction_grid/spacing": "mm",
    "/entry/reconstruction_grid/origin": "mm",
}


def validate(path: Path | str, air: str | None = None) -> list[str]:
    """Return everything that is wrong with a dataset, one sentence each; empty when nothing is.

    Parameters
    ----------
    path : of the dataset
    air : region of the panel that sees only air, for a file without flats

    Returns
    -------
    sentences

    Raises
    ------
    DatasetError
        When the file cannot be opened as a dataset at all.
    """
    path = Path(path)
    with open_file(path) as file:
        sound = not any(form_problems(file, ENTRY))
        impossible = list(value_problems(file, ENTRY)) if sound else []
    if impossible:
        return impossible
    with open_dataset(path, air, as_stored=True) as dataset:
        problems = [sentence for check in _CHECKS for sentence in check(dataset)]
        for whole in (seal_problems, chunk_problems, outside_problems):
            problems += _checked(lambda whole=whole: list(whole(dataset.file)))
        names = dataset.spectra.basis.names
    problems += _checked(lambda: list(_step_problems("/truth/geometry", read_true_geometry(path))))
    return problems + _checked(lambda: list(_truth_problems(read_truth(path), names)))


def newer_minor(dataset: Dataset) -> str | None:
    """Return a warning when the file was written by a newer program, which is harmless.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    one sentence, or None
    """
    version = str(dataset.file.attrs["schema_version"])
    minor = version.partition(".")[2]
    if minor.isdigit() and int(minor) > SCHEMA_VERSION[1]:
        return f"{dataset.path} has schema version {version}; what is new in it is not shown"
    return None


def _checked(check: Callable[[], list[str]]) -> list[str]:
    """Sentences of a check, also when it stops at an error."""
    try:
        return check()
    except Error as error:
        return [str(error)]


def _count_problems(dataset: Dataset) -> Iterator[str]:
    """Counts that are negative, not numbers or unreadable."""
    for name in (f"{DETECTOR}/data", FLAT, DARK):
        frames = find_array(dataset.file, name)
        if frames is None:
            continue
        for frame in range(frames.shape[0]):
            try:
                check_counts(frame_at(frames, frame), f"{name}[{frame}]", dataset.signed)
            except DatasetError as error:
                yield str(error)
                break


def _unit_problems(dataset: Dataset) -> Iterator[str]:
    """Units that are missing or others."""
    found = dataset.counts.attrs.get("units")
    if found not in _SIGNALS:
        yield f"{DETECTOR}/data must have units='counts', or 'keV' for a sum of energies, found {found!r}"
    start = {"/entry/geometry/ray_direction": "1"} if dataset.geometry.is_parallel else {"/entry/geometry/source": "mm"}
    for name, units in {**_UNITS, **start}.items():
        found = dataset.file[name].attrs.get("units") if name in dataset.file else None
        if found != units:
            yield f"{name} must have units={units!r}, found {found!r}"


def _spectra_problems(dataset: Dataset) -> Iterator[str]:
    """Energies out of order, a stored basis that is negative, or is not what its table says."""
    spectra = dataset.spectra
    if len(spectra.edges) != len(spectra.energy) + 1 or not (np.diff(spectra.edges) > 0).all():
        yield "/entry/spectra/energy_edges must ascend and have one entry more than energy"
    if spectra.basis_values.min() < 0 and not spectra.basis.signed:
        yield "/entry/spectra/basis holds a value that is negative"
    if (spectra.variance is None) != (spectra.units == "counts"):
        yield "/entry/spectra/variance belongs to signals in keV, and to these only"
    if not np.allclose(spectra.basis.evaluate(spectra.energy), spectra.basis_values, rtol=1e-6):
        what = "basis_composition" if any(f.amounts for f in spectra.basis.functions) else "element"
        yield f"/entry/spectra/basis is not what basis_kind, edge_energy, edge_width and {what} describe"


def _geometry_problems(dataset: Dataset) -> Iterator[str]:
    """An unknown kind of orbit, steps that do not fit the pixel sizes."""
    if dataset.geometry.kind not in KINDS:
        yield f"/entry/geometry/kind must be one of {', '.join(KINDS)}, found {dataset.geometry.kind!r}"
    yield from _step_problems("/entry/geometry", dataset.geometry)


def _step_problems(group: str, geometry: Geometry | None) -> Iterator[str]:
    """Steps that do not fit the pixel sizes."""
    if geometry is None:
        return
    for name, pitch in (("column_step", geometry.panel.column_pitch), ("row_step", geometry.panel.row_pitch)):
        length = np.linalg.norm(getattr(geometry, name), axis=1)
        if not np.allclose(length, pitch, rtol=1e-6):
            yield f"{group}/{name} has length {length.min():g}..{length.max():g} mm, the pixels {pitch:g}"


def _split_problems(dataset: Dataset) -> Iterator[str]:
    """Views in two splits at once, or twice in one."""
    for name, views in dataset.splits.items():
        if len(np.unique(views)) != len(views):
            yield f"split {name} names a view twice"
    for (a, first), (b, second) in combinations(dataset.splits.items(), 2):
        both = np.intersect1d(first, second)
        if len(both):
            yield f"view {both[0]} is in split {a} and in split {b}"


def _truth_problems(truth: Truth | None, basis_names: tuple[str, ...]) -> Iterator[str]:
    """Truth that does not fit itself or the basis."""
    if truth is None:
        return
    if truth.basis_names != basis_names:
        yield f"/truth/basis is in {', '.join(truth.basis_names)}, the spectra in {', '.join(basis_names)}"
    if truth.volumes.shape != (len(truth.basis_names), *truth.grid.shape) or not np.isfinite(truth.volumes).all():
        yield "/truth/basis/data does not fit its grid, or holds a value that is not a number"


_CHECKS: tuple[Callable[[Dataset], Iterator[str]], ...] = (
    _unit_problems,
    _spectra_problems,
    _geometry_problems,
    _split_problems,
    _count_problems,
)
