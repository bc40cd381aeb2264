"""Interface for Python programs: fit a dataset, evaluate, render, score and save the fit, and find its materials."""

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset, Region, open_dataset
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.effects.smooth_signal import SmoothSignal
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.guarded import Guard, WarnOnFailure, unguarded
from phantomgen.runtime.plain_json import to_json, write_json
from phantomgen.runtime.stopwatch import peak_memory_mib
from phantomgen.runtime.thumbnails import thumbnails
from recon.callbacks import ProgressBar
from recon.data.devices import device_named
from recon.evaluation.stated_volume import Statement
from recon.evaluation.verdict import Verdict
from recon.gaussians.model import GaussianModel
from recon.gaussians.optimize import Progress
from recon.gaussians.processes import Resources
from recon.gaussians.recipe import RECIPES, Recipe
from recon.gaussians.reconstruct import Reconstruction, reconstruct
from recon.kedge.basis_names import Asked, left_out, parse_bases, with_named
from recon.kedge.choose_basis import BasisChoice, choose_basis
from recon.output.render_file import rendered, views_of_geometry
from recon.output.report.page import report_figures as figures_of_report
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.reconstruct import reconstruct_paper
from recon.readouts.fractions import named_materials
from recon.readouts.quantity import in_pieces, quantity
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.outcomes.score_volume import score_volume
from recon.runs.outcomes.volume_outcome import VolumeOutcome
from recon.runs.read_run import StoredModel, open_model
from recon.runs.run_folder import Run
from recon.runs.run_gaussians import on_curve, outcome_of_fit
from recon.runs.unfinished_run import LOG, log_entry
from recon.runs.write_run import RunFolder
from recon.scatter.chosen_scatter import SCATTER, ChosenScatter, parse_scatter
from recon.segmentation.clustering import BANDWIDTH
from recon.segmentation.result import ENERGY, FEATURES, Options, Segmentation
from recon.segmentation.segment import segment_subject
from recon.segmentation.subject import Subject, open_subject
from spectra.basis.basis import Basis, pretty
from spectra.errors import InputError
from spectra.materials.material import Material

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Projections:
    """Projections of a model.

    Parameters
    ----------
    line_integrals : of every basis [no unit]
    counts : expected number of photons in every channel
    """

    line_integrals: Float[np.ndarray, "view basis row column"]
    counts: Float[np.ndarray, "view channel row column"]


@dataclass(frozen=True, eq=False)
class QuantityMap:
    """A physical quantity in every voxel.

    Parameters
    ----------
    name : such as ``hounsfield_70_keV``
    values : values in `unit`; of a quantity with several maps with an axis for them before the others
    unit : ``1/mm``, ``HU``, ``mg/ml``, or ``1``
    grid : the voxels
    """

    name: str
    values: Float[np.ndarray, "*map z y x"]
    unit: str
    grid: Grid

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """Return the values, so that functions of NumPy take the map."""
        return np.array(self.values, dtype=dtype) if copy else np.asarray(self.values, dtype=dtype)

    def __repr__(self) -> str:
        unit = "" if self.unit == "1" else f" [{self.unit}]"
        return f"QuantityMap({self.name}{unit}: {' x '.join(map(str, self.grid.shape))} voxels)"

    def _repr_html_(self) -> str:
        """Picture of the middle slice for notebooks."""
        return thumbnails(repr(self), [(self.name, self.values[self.grid.shape[0] // 2, ::-1])])


@dataclass(frozen=True, eq=False)
class Fit:
    """A finished fit.

    Parameters
    ----------
    result : model, the volumes that it started from, its spectral model, and time per stage
    basis : functions of energy that the dataset states or that were found; those of the model are the first
    grid : of the dataset
    recipe : hyper-parameters of the fit
    path : dataset, which is opened again for scores and names of channels
    air : part of the panel that takes the place of flats; None for flats
    choice : of basis functions; None for the paper's method, which fits those that are asked for
    left_out : names of the dataset's basis functions that are not fitted
    log : one entry per step
    scatter : signal that was taken away from the counts; None for none
    """

    result: Reconstruction
    basis: Basis
    grid: Grid
    recipe: Recipe | PaperRecipe
    path: Path
    air: Region | None = None
    choice: BasisChoice | None = None
    left_out: tuple[str, ...] = ()
    log: list[dict[str, Any]] = field(default_factory=list, repr=False)
    scatter: SmoothSignal | None = field(default=None, repr=False)

    @property
    def gaussians(self) -> GaussianModel:
        """The model."""
        return self.result.gaussians

    @property
    def basis_names(self) -> tuple[str, ...]:
        """Names of the model's bases."""
        return self.gaussians.basis_names

    def __repr__(self) -> str:
        seconds = sum(self.result.seconds.values())
        return f"Fit({self.path.name}: {len(self.gaussians)} Gaussians, {', '.join(self.basis_names)}, {seconds:.0f} s)"

    def _repr_html_(self) -> str:
        """Picture of the middle slice for notebooks."""
        middle = self.grid.slices(self.grid.shape[0] // 2, 1)
        images = [(pretty(n), v[0, ::-1]) for n, v in zip(self.basis_names, self.volume(middle), strict=True)]
        return thumbnails(repr(self), images)

    def volume(self, grid: Grid | None = None) -> Float[np.ndarray, "basis z y x"]:
        """Compute the basis volumes on a grid.

        Parameters
        ----------
        grid : any grid; None for that of the dataset

        Returns
        -------
        means over the voxels [1/mm]
        """
        return self.gaussians.volume(grid or self.grid)

    def render(self, geometry: Geometry) -> Projections:
        """Compute projections in any views.

        Parameters
        ----------
        geometry : poses of the views

        Returns
        -------
        line integrals, and expected counts of ideal pixels that get as many photons as those of the scan
        """
        transmission = self.result.transmission
        columns = transmission.columns[: len(self.basis_names)]
        run = Run(self.gaussians, self.grid, self.basis, replace(transmission, columns=columns))
        views = views_of_geometry(run, geometry)
        images = [rendered(run, views, view) for view in range(len(geometry))]
        lengths, counts = (np.stack(parts) for parts in zip(*images, strict=True))
        return Projections(lengths, counts.astype(np.float32))

    @property
    def verdict(self) -> Verdict:
        """Remarks on the result, made without the truth; see `recon.evaluation.verdict`."""
        with self._outcome() as outcome:
            return outcome.verdict(outcome.score_test_views())

    def score(self) -> dict[str, Any]:
        """Score the fit against the truth, where the dataset has one, and on its test views.

        Returns
        -------
        what ``metrics.json`` holds
        """
        with self._outcome() as outcome:
            return self._metrics(outcome, unguarded)

    def save(self, folder: Path | str, *, overwrite: bool = False) -> Path:
        """Write a run folder that every command of ``recon`` reads, scores included.

        The model and its volumes are written first; scores that fail are left out and warned of.

        Parameters
        ----------
        folder : name of the run folder
        overwrite : replace a run folder that exists

        Returns
        -------
        the run folder

        Raises
        ------
        InputError
            When the folder exists and `overwrite` is not given.
        """
        target = RunFolder(Path(folder), overwrite)
        guard = WarnOnFailure(lambda sentence, error: warnings.warn(sentence, RuntimeWarning, stacklevel=5))
        with target as part, self._outcome() as outcome:
            outcome.write(part)
            ChosenScatter(outcome.dataset).write(part / SCATTER)
            (part / LOG).write_text("".join(to_json(entry) + "\n" for entry in self.log), encoding="utf-8")
            metrics = self._metrics(outcome, guard)
            write_json(part / "metrics.json", metrics | ({"failed": guard.failed} if guard.failed else {}))
        return target.path

    def _metrics(self, outcome: VolumeOutcome, guard: Guard) -> dict[str, Any]:
        """Scores, times and memory, without what `guard` catches."""
        truth: Truth | None = None
        with guard("reading the truth"):
            truth = read_truth(self.path)
        scores = outcome.scores(truth, guard)
        return scores | {"seconds": self.result.seconds, "peak_memory_mib": peak_memory_mib()}

    @contextmanager
    def _outcome(self) -> Iterator[VolumeOutcome]:
        """The fit as runs write and score it, while its dataset is open."""
        with open_dataset(self.path, self.air) as dataset:
            fitted = dataset.with_basis(self.basis)
            fitted = fitted if self.scatter is None else fitted.with_scatter(self.scatter)
            yield outcome_of_fit(fitted, self.recipe, self.result, self.choice, self.left_out)


def fit(
    dataset: Dataset | str | Path,
    recipe: Recipe | PaperRecipe | str = "fast",
    *,
    bases: Asked | str = None,
    edges: Sequence[float] | None = None,
    scatter: str | None = None,
    callbacks: Sequence[Any] = (),
    progress: bool = False,
    device: str = "cpu",
) -> Fit:
    """Fit Gaussians to the training views of a dataset; its truth is not read.

    Parameters
    ----------
    dataset : open dataset, or its file
    recipe : hyper-parameters, or ``fast``, ``best`` or ``paper``
    bases : how many basis functions to fit, or their names, such as ``("photoelectric", "compton", "kedge_I")``; for a
        scan with one channel a curve of materials, ``"curve"`` or ``"curve:water,Ti"``; those that the counts warrant
        where left out
    edges : where to look for K edges [keV], see `recon.kedge.choose_basis.choose_basis`; None to believe the dataset
    scatter : estimate of scatter that is taken away: ``"compton"``, ``"compton:FACTOR"``, ``"compton:fit"``,
        ``"compton:fit-channels"``, or ``"kernel:RATIO,WIDTH"`` with the width in mm; None for none
    callbacks : functions, or objects with a method ``on_step``, that get a `recon.gaussians.optimize.Progress` after
        every step and end the fit by returning True; objects may have a method ``on_end`` that gets the finished `Fit`;
        see `recon.EarlyStop`
    progress : show a progress bar, in notebooks as a widget where they have one
    device : where Gaussians and the voxels of their start are computed, ``cpu`` or ``cuda``; the finished fit is on the
        processor

    Returns
    -------
    the finished fit

    Raises
    ------
    InputError
        When there is no such recipe or device, or the data cannot be fitted as asked.
    """
    if not isinstance(dataset, Dataset):
        with open_dataset(dataset) as opened:
            return fit(
                opened, recipe, bases=bases, edges=edges, scatter=scatter, callbacks=callbacks, progress=progress,
                device=device,
            )  # fmt: skip
    asked = parse_bases(bases) if isinstance(bases, str) else bases
    dataset = ChosenScatter.of(dataset, parse_scatter(scatter), asked).dataset
    callbacks = [*callbacks, ProgressBar()] if progress else callbacks
    how, log, stated = on_curve(_recipe(recipe), asked, dataset), [], dataset.spectra.basis.names
    after_step = [_on_step(callback) for callback in callbacks]

    def on_step(step: Progress) -> bool:
        if step.step <= len(log):  # the fit has begun anew
            log.clear()
        log.append(log_entry(step, dataset.spectra.channels))
        return any([bool(callback(step)) for callback in after_step])  # noqa: C419 - all callbacks are called

    resources = Resources(device=device_named(device).type)
    if isinstance(how, PaperRecipe):
        if device != "cpu":
            raise InputError(f"the recipe paper is computed by the processor: leave out device={device!r}")
        chosen, count = with_named(dataset, asked)
        choice, basis = None, chosen.spectra.basis
        result = reconstruct_paper(chosen, how, count, on_step=on_step)
    else:
        choice = choose_basis(dataset, asked, edges)
        basis = choice.basis
        result = reconstruct(dataset.with_basis(basis), how, on_step=on_step, resources=resources)
    missing = left_out(stated, result.gaussians.basis_names)
    finished = Fit(
        result, basis, dataset.grid, how, dataset.path.absolute(), dataset.air, choice, missing, log, dataset.scatter
    )
    for callback in callbacks:
        if hasattr(callback, "on_end"):
            callback.on_end(finished)
    return finished


def segment(
    run: Fit | Path | str,
    *,
    domain: str | None = None,
    features: str = FEATURES[0],
    bandwidth: float = BANDWIDTH,
    energies: Sequence[float] = (ENERGY,),
    seed: int = 0,
) -> Segmentation:
    """Find the materials of a finished fit, or of a run folder that ``recon fit`` wrote; their truth is not read.

    Parameters
    ----------
    run : a fit, or a folder of any method
    domain : ``gaussians`` or ``voxels``; None for Gaussians where a run has them
    features : features of the values at each Gaussian (``local``), or of its own coefficients (``own``)
    bandwidth : bandwidth of the mean shift, in units of `recon.segmentation.clustering.unit_of`
    energies : energies of virtual monoenergetic images [keV]
    seed : seed of the choice of samples

    Returns
    -------
    materials, with their labels, densities and images

    Raises
    ------
    DatasetError
        When the folder is not a complete run of this version.
    InputError
        When a value is not possible, the run has no Gaussians to segment, or only air.
    """
    chosen = Options(domain, features, bandwidth, tuple(energies), seed)
    if not isinstance(run, Fit):
        return segment_subject(open_subject(Path(run)), chosen)
    stored, name = _stored(run), run.path.name
    subject = Subject.of(run.volume(), run.grid, stored.basis, stored.transmission, run.gaussians, name)
    return segment_subject(subject, chosen)


def readout(
    run: Fit | Path | str,
    what: str,
    energy: float | None = None,
    water: str | float | None = None,
    grid: Grid | None = None,
    materials: Sequence[str | Material] = (),
) -> QuantityMap:
    """Compute a quantity of a finished fit, or of a run folder of any method, in every voxel.

    Parameters
    ----------
    run : a fit, or a folder
    what : ``vmi``, ``hu``, ``vnc``, ``electron-density``, ``zeff``, ``fractions``, or an element such as ``iodine``
    energy : energy of ``vmi``, ``hu`` and ``vnc`` [keV]; 70 where it is left out
    water : what 0 HU is: ``basis`` (the default), ``table``, or the attenuation of water at the energy [1/mm]
    grid : any grid; that of the dataset where it is left out
    materials : of ``fractions``: compositions, where needed with a density, such as ``hydroxyapatite:2.9``, or
        materials

    Returns
    -------
    values with their unit; volume fractions have an axis for the materials before the others

    Raises
    ------
    DatasetError
        When the folder is not a complete run of this version.
    InputError
        When there is no such quantity, or the basis of the run cannot show it.

    Warns
    -----
    UserWarning
        When the energy is outside of the detected spectrum.

    Notes
    -----
    `Readouts.of(basis, energy, weights)` computes the same quantities of arrays of coefficients, such as volumes of
    another program.
    """
    stored = _stored(run) if isinstance(run, Fit) else open_model(Path(run))
    spectrum = detected_spectrum(stored.basis, stored.transmission)
    chosen = quantity(Readouts.of(stored.basis, *spectrum), what, energy, water, named_materials(materials))
    if chosen.caution:
        warnings.warn(chosen.caution, stacklevel=2)
    place = grid or stored.grid
    return QuantityMap(chosen.name, in_pieces(chosen, stored.model.volume(place)), chosen.unit, place)


def _stored(run: Fit) -> StoredModel:
    """A fit as what is read from its folder."""
    basis = Basis(run.basis.functions[: len(run.basis_names)], run.basis.reference_energy)
    return StoredModel(run.gaussians, run.grid, basis, run.result.transmission)


def score(
    volume: Any,
    dataset: Dataset | str | Path,
    quantity: str | Sequence[str] = (),
    *,
    units: str | None = None,
    axes: str | None = None,
    voxel_mm: float | Sequence[float] | None = None,
    origin_mm: Sequence[float] | str | None = None,
    same_grid: bool = False,
    coordinates: str = "header",
    out: Path | str | None = None,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Score a volume of any program against the truth of a dataset, as runs are scored.

    Parameters
    ----------
    volume : array or tensor, file or run folder, or several of them; an array needs `axes`, and where its voxels are
    dataset : open dataset with a truth, or its file
    quantity : what each part holds, such as ``basis:photoelectric``, ``mono:60``, ``channel:bin1``, ``hu:60`` or
        ``density:iodine``; nothing for files that name their basis volumes
    units : of the values, such as ``1/cm``; None where the file says, and for Hounsfield units
    axes : axis of the scan along each axis of the array, such as ``zyx`` or ``x-yz``; None where the file says
    voxel_mm : size of a voxel, or sizes along (z, y, x); None where the file says
    origin_mm : centre of the first voxel (z, y, x), or ``center`` for a volume around the isocentre; None where the
        file says
    same_grid : whether the voxels are those of the dataset, in place of the two
    coordinates : ``header``, or ``scan`` for images whose coordinates are those of the scan and not of a patient
    out : folder to write, with figures; None for no files
    overwrite : replace a folder that exists

    Returns
    -------
    what ``metrics.json`` holds

    Raises
    ------
    InputError
        When a volume cannot be read, or what it holds or where it lies is not known.
    DatasetError
        When the dataset holds no truth.
    """
    if not isinstance(dataset, Dataset):
        with open_dataset(dataset) as opened:
            stated = {"units": units, "axes": axes, "voxel_mm": voxel_mm, "origin_mm": origin_mm}
            rest = {"same_grid": same_grid, "coordinates": coordinates, "out": out, "overwrite": overwrite}
            return score(volume, opened, quantity, **stated, **rest)
    options = {
        "as": quantity,
        "units": units,
        "axes": axes,
        "voxel-mm": _numbers_text(voxel_mm),
        "origin-mm": _numbers_text(origin_mm),
        "same-grid": same_grid,
        "coordinates": coordinates,
    }
    sources = [volume] if isinstance(volume, (str, Path)) or hasattr(volume, "__array__") else list(volume)
    folder = None if out is None else RunFolder(Path(out), overwrite)
    return score_volume(
        [str(source) if isinstance(source, (str, Path)) else np.asarray(source) for source in sources],
        dataset,
        Statement.of(options, dataset.grid),
        folder,
        figures=True,
        on_stage=lambda name: None,
        warn=lambda sentence, error: warnings.warn(sentence, RuntimeWarning, stacklevel=4),
    )


def report_figures(
    run: Fit | Path | str | Sequence[Path | str], dataset: Dataset | Path | str | None = None
) -> dict[str, "Figure"]:
    """Draw the figures of ``recon report``.

    Parameters
    ----------
    run : a fit, a run folder of any method, or several folders of runs of one scan
    dataset : the scan; that of the fit, or the file of its name beside the runs, where left out

    Returns
    -------
    figures of matplotlib by their names, such as ``axial``, ``profiles``, ``edge_response`` and ``noise_power``; those
    that runs, dataset and truth allow

    Raises
    ------
    DatasetError
        When a folder is no finished run, or the dataset cannot be read.
    InputError
        When the runs are of different scans, or the dataset is another one.
    """
    scan = dataset.path if isinstance(dataset, Dataset) else None if dataset is None else Path(dataset)
    if isinstance(run, Fit):
        with TemporaryDirectory() as folder:
            return figures_of_report([run.save(Path(folder, "result"))], scan or run.path)
    folders = [run] if isinstance(run, Path | str) else run
    return figures_of_report([Path(folder) for folder in folders], scan)


def _numbers_text(value: float | Sequence[float] | str | None) -> str | None:
    """Numbers as the options of the command take them."""
    if value is None or isinstance(value, str):
        return value
    return ",".join(repr(float(number)) for number in np.atleast_1d(np.asarray(value, dtype=np.float64)))


def _recipe(recipe: Recipe | PaperRecipe | str) -> Recipe | PaperRecipe:
    if not isinstance(recipe, str):
        return recipe
    if recipe == "paper":
        return PaperRecipe()
    if recipe not in RECIPES:
        known = ", ".join([*RECIPES, "paper"])
        raise InputError(f"there is no recipe {recipe!r}: choose from {known}, or pass a recon.Recipe")
    return RECIPES[recipe]


def _on_step(callback: Any) -> Callable[[Progress], Any]:
    """Function to call after a step."""
    if hasattr(callback, "on_step"):
        return callback.on_step
    if hasattr(callback, "on_end"):
        return lambda progress: None
    if not callable(callback):
        raise InputError(f"a callback is a function or has a method on_step or on_end, got {callback!r}")
    return callback
