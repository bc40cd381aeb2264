"""Phases of a run: read its model and its scan, fit, write volumes, scores, a figure and a film."""

from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from jaxtyping import Float, Int

from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.time.true_phases import read_phases
from phantomgen.dataset.time.view_times import ViewTimes
from phantomgen.dataset.truth import read_truth, write_grid
from phantomgen.runtime.hdf5_output import hdf5_output
from phantomgen.runtime.plain_json import write_json
from recon.evaluation.metrics import psnr
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.fitted_grid import read_with_coverage
from recon.gaussians.recipe import Recipe
from recon.kedge.basis_names import named_basis
from recon.phases.alone import remove_kept, with_phases_alone, with_unseen_rays_of_phases
from recon.phases.figures import draw_film, draw_phases
from recon.phases.fit import PhaseProgress, fit_phases
from recon.phases.model import PhaseGaussians
from recon.phases.settings import PhaseSettings
from recon.runs.run_folder import MODEL
from spectra.errors import InputError

PHASES, PHASE_SCORES = "phases.h5", "phases.json"
FIGURE, FILM = "phases.png", "phases.gif"
AUTO = "auto"


class Division(NamedTuple):
    """Division of the training views into phases.

    Parameters
    ----------
    phase : of each training view
    cyclic : whether the first phase follows the last
    stated : whether it is that of the dataset, whose truth has these phases
    """

    phase: Int[np.ndarray, " view"]
    cyclic: bool
    stated: bool


def divide(dataset: Dataset, asked: str) -> Division:
    """Divide the training views of a dataset into phases.

    Parameters
    ----------
    dataset : open dataset
    asked : ``auto`` for the phases of the file, a number for equal parts of the time, or ``number:cycle``

    Returns
    -------
    the division

    Raises
    ------
    InputError
        When the file states no times or no phases, there is no such cycle, or a phase would hold no view.
    """
    times, train = dataset.view_times, dataset.splits["train"]
    if times is None:
        raise InputError(f"{dataset.path} states no times of its views: --phases needs a scan with /entry/time")
    if asked == AUTO:
        if times.phase is None:
            raise InputError(f"{dataset.path} does not divide its views: give --phases a number, such as 8")
        phase, count, by = times.phase, times.phases, _cycle_of(times.phase, times)
    else:
        number, _, cycle = asked.partition(":")
        if not number.isdigit() or not 2 <= int(number) <= 100:
            raise InputError(f"--phases takes auto, or a number from 2 to 100, with :CYCLE if any, got {asked!r}")
        count, by = int(number), cycle or None
        phase = times.divided(count, by)
    own = phase[train]
    lacking = sorted(set(range(count)) - set(own.tolist()))
    if lacking:
        raise InputError(
            f"{len(lacking)} of {count} phases of {dataset.path} hold no training view, the first is phase "
            f"{lacking[0]}: give fewer phases"
        )
    stated = times.phase is not None and times.phases == count and bool((phase == times.phase).all())
    return Division(own, by is not None, stated)


def _cycle_of(phase: Int[np.ndarray, " view"], times: ViewTimes) -> str | None:
    """Name of the cycle that views are divided by; None where it is the time."""
    matching = (name for name in times.cycles if (times.divided(times.phases, name) == phase).all())
    return next(matching, None)


def fit_phases_of_run(
    dataset: Dataset,
    folder: Path,
    division: Division,
    recipe: Recipe,
    settings: PhaseSettings,
    figures: bool,
    on_step: Callable[[PhaseProgress], object] = lambda progress: None,
    on_stage: Callable[[str], object] = lambda name: None,
) -> dict[str, Any]:
    """Fit the phases of a scan, from the model of a run, and write them into its folder.

    Parameters
    ----------
    dataset : open dataset of the run
    folder : of the run, whose model is that of all views
    division : of the training views
    recipe : of the run
    settings : how phases are fitted
    figures : whether to draw
    on_step : called after the first coefficients of each phase, and after every step
    on_stage : called with a name when phases are fitted together, and when one is fitted alone

    Returns
    -------
    what ``phases.json`` holds
    """
    model = load_model(folder / MODEL)
    named = dataset.with_basis(named_basis(dataset.spectra.basis, model.basis_names, dataset.path))
    scan = read_with_coverage(named, recipe)
    grid, voxel = scan.coverage.grid, min(dataset.grid.spacing)
    measured = with_unseen_rays_of_phases(scan.measured, division.phase, voxel, recipe)
    on_stage("phases")
    found = fit_phases(model, measured, division.phase, division.cyclic, grid, recipe, settings, on_step)
    tell = partial(_tell_alone, on_stage, len(found))
    found = with_phases_alone(found, named, measured, division.phase, grid, recipe, tell, folder)
    volumes, static = found.volumes(dataset.grid), model.volume(dataset.grid)
    _write(folder / PHASES, found, volumes, dataset)
    scores: dict[str, Any] = {
        "phases": len(found),
        "views": np.bincount(division.phase).tolist(),
        "cyclic": division.cyclic,
        "alone": {str(phase): round(own.weight, 3) for phase, own in sorted(found.alone.items())},
        "settings": asdict(settings),
    }
    true = _true_volumes(dataset, model.basis_names) if division.stated else None
    if true is not None:
        scores["psnr"] = {
            "phases": _psnr(volumes, true, model.basis_names),
            "static": _psnr(np.broadcast_to(static, true.shape), true, model.basis_names),
        }
    write_json(folder / PHASE_SCORES, scores)
    remove_kept(folder)
    if figures:
        draw_phases(volumes, true, model.basis_names, dataset.grid, folder / "figures" / FIGURE)
        draw_film(volumes, true, model.basis_names, dataset.grid, folder / "figures" / FILM)
    return scores


def _tell_alone(on_stage: Callable[[str], object], count: int, phase: int) -> None:
    on_stage(f"phase {phase} alone, {phase + 1} of {count}")


def _true_volumes(dataset: Dataset, names: tuple[str, ...]) -> Float[np.ndarray, "phase basis z y x"] | None:
    """True volumes of the phases in some bases; None where the truth lacks phases or one of the bases."""
    phases, truth = read_phases(dataset.path), read_truth(dataset.path)
    if phases is None or truth is None or not set(names) <= set(truth.basis_names):
        return None
    return phases[:, [truth.basis_names.index(name) for name in names]]


def _psnr(
    volumes: Float[np.ndarray, "phase basis z y x"],
    true: Float[np.ndarray, "phase basis z y x"],
    names: tuple[str, ...],
) -> dict[str, list[float | None]]:
    """PSNR of each phase by basis, with the largest true value of all phases as peak [dB]."""
    peaks = true.max(axis=(0, 2, 3, 4))
    errors = np.square(volumes - true).mean(axis=(2, 3, 4), dtype=np.float64)
    return {
        name: [psnr(float(peaks[basis]), float(error)) for error in errors[:, basis]]
        for basis, name in enumerate(names)
    }


def phase_table(scores: dict[str, Any]) -> str:
    """Format the scores of phases.

    Parameters
    ----------
    scores : what `fit_phases_of_run` returned

    Returns
    -------
    a line per phase with the PSNR of each basis, beside that of the model of all views, and the weight of the fit of
    this phase alone; without a truth, the views
    """
    count = scores["phases"]
    if "psnr" not in scores:
        return f"{count} phases of {min(scores['views'])} to {max(scores['views'])} views"
    found, static = scores["psnr"]["phases"], scores["psnr"]["static"]
    lines = [f"{'PSNR [dB]':<10} {'views':>5}  " + "  ".join(f"{name:>22}" for name in found)]
    for phase in range(count):
        pairs = (f"{_decibel(found[n][phase])} ({_decibel(static[n][phase])} static)" for n in found)
        columns = "  ".join(f"{pair:>22}" for pair in pairs)
        weight = scores["alone"].get(str(phase), 0.0)
        lines.append(f"{f'phase {phase}':<10} {scores['views'][phase]:>5}  {columns}  {weight:.2f} alone")
    return "\n".join(lines)


def _decibel(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def _write(
    path: Path, found: PhaseGaussians, volumes: Float[np.ndarray, "phase basis z y x"], dataset: Dataset
) -> None:
    """Write basis volumes of all phases, and what makes the Gaussians of each."""
    with hdf5_output(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "phases", "creator": "recon"})
        group = new_group(file, "phases", "NXdata", signal="data", axes=("phase", "basis_name", "z", "y", "x"))
        _packed(group, "data", volumes).attrs["units"] = "1/mm"
        put(group, "phase", np.arange(len(found), dtype=np.int32))
        put(group, "basis_name", np.array(found.shared.basis_names, dtype=object))
        for axis in "zyx":
            put(group, axis, dataset.grid.axis(axis), "mm")
        model = new_group(file, "gaussians", "NXcollection")
        for name, values in found.shared.tensors().items():
            if name != "coefficients":  # shapes that all phases share; those of the run's model were the start
                put(model, name, values.detach().numpy())
        model.attrs.update(found.shared.header())
        _packed(model, "coefficients", found.coefficients.numpy()).attrs["units"] = "1/mm"
        shifts = np.stack([found.lattice.at_gaussians(nodes).numpy() for nodes in found.displacements])
        _packed(model, "displacements", shifts).attrs["units"] = "mm"
        for phase, (gaussians, weight) in found.alone.items():
            own = new_group(model, f"phase_{phase}", "NXcollection")
            for name, values in gaussians.tensors().items():
                put(own, name, values.detach().numpy())
            own.attrs.update(gaussians.header() | {"weight": weight})
        write_grid(new_group(file, "grid", "NXcollection"), dataset.grid)


def _packed(group: h5py.Group, name: str, values: np.ndarray) -> h5py.Dataset:
    """Write an array, compressed."""
    chunks = (*[1] * (values.ndim - 2), *values.shape[-2:])
    return group.create_dataset(
        name, data=values.astype(np.float32), chunks=chunks, compression="gzip", compression_opts=1, shuffle=True,
        fletcher32=True,
    )  # fmt: skip
