"""Projections of the views of a scan at few energies, kept in its dataset, so that other spectra need no rays.

See `phantomgen.simulation.projection_cache.energies` for what is kept, and `ProjectionCache.primary` for what becomes
of it: counts of a pixel are sum_k w_k exp(-p(E_k)), with p(E_k) a combination of what is kept and w_k the photons x
response of any spectrum.
"""

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Float32

from phantomgen.dataset.checks.door import array_at, group_at, value_at
from phantomgen.dataset.compression import Compression
from phantomgen.dataset.file import open_file
from phantomgen.dataset.layout import FRACTION_SCALE, new_frames, new_group, put, put_note, text_of
from phantomgen.dataset.truth import truth_group
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.energy_grids import fine_cuts, node_energies
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.forward_model.exposure import Exposure, Groups
from phantomgen.simulation.forward_model.fingerprint import digest
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.planning.plan import BINS, ENERGY, Choice, Plan
from phantomgen.simulation.projection_cache.energies import SHARE, attenuation, cache_energies
from spectra.energy.chebyshev import PiecewiseChebyshev
from spectra.errors import DatasetError, InputError
from spectra.transmission import Transmission

GROUP = "truth/paths"


@dataclass(frozen=True, eq=False)
class CacheWriter:
    """Writer of the projections of a scan at a few energies.

    Parameters
    ----------
    scan, settings : what is simulated, how finely
    energies : at which projections are kept
    error : worst error of projections at other energies
    """

    scan: Scan
    settings: Settings
    energies: PiecewiseChebyshev
    error: float

    @classmethod
    def of(cls, plan: Plan) -> "CacheWriter":
        """Create the writer for the spectra that the scan of a plan may get.

        Parameters
        ----------
        plan : plan of the scan

        Returns
        -------
        the writer
        """
        return cls(plan.scan, plan.settings, *cache_energies(plan.scan, SHARE * plan.tolerance))

    def images(self, view: int) -> list[Float32[np.ndarray, "row column"]]:
        """Compute the projections of a view at each energy, averaged as intensities over pixels and focal spot.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        images, (row, column), one per energy
        """
        nodes = self.energies.nodes
        one_each = Transmission(attenuation(self.scan, nodes), np.ones(len(nodes)), np.arange(len(nodes) + 1))
        bare = replace(self.scan, profile=None)
        left = np.maximum(expected_view(bare, one_each, view, self.settings), np.finfo(np.float64).tiny)
        return list((0.0 - np.log(left)).astype(np.float32))

    def new_array(self, file: h5py.File, compression: Compression) -> h5py.Dataset:
        """Create an empty array in the truth of a file, and beside it the values that a later run requires.

        Parameters
        ----------
        file : open dataset
        compression : of the array

        Returns
        -------
        the array
        """
        scan, nodes = self.scan, self.energies.nodes
        group = new_group(truth_group(file), "paths", "NXdata", signal="data", axes=("view", "energy", ".", "."))
        put(group, "energy", nodes, "keV")
        put(group, "bounds", np.array(self.energies.bounds), "keV")
        put(group, "nodes", np.array(self.energies.counts))
        put(group, "error", self.error)
        put_note(group, "depends_on", json.dumps(fingerprint(scan, nodes)), "application/json")
        panel = scan.geometry.panel
        shape = (len(scan.geometry), len(nodes), panel.rows, panel.columns)
        return new_frames(group, "data", shape, np.float32, "1", compression)


@dataclass(frozen=True, eq=False)
class ProjectionCache:
    """Stored projections of a dataset.

    Parameters
    ----------
    path : of the dataset
    energies : of the projections
    choices : parts of the plan that they were computed by, and the error of each; last that of other energies
    tolerance, settings : of that plan
    depends_on : digests of all that projections depend on
    """

    path: Path
    energies: PiecewiseChebyshev
    choices: tuple[Choice, ...]
    tolerance: float
    settings: Settings
    depends_on: dict[str, str]

    @classmethod
    def read(cls, path: Path | str) -> "ProjectionCache":
        """Read the stored projections of a dataset.

        Parameters
        ----------
        path : the dataset

        Returns
        -------
        the projections; images stay in the file

        Raises
        ------
        DatasetError
            When it is no dataset, or keeps no projections.
        """
        with _opened(path) as file:
            group = group_at(file, GROUP)
            bounds, counts = (array_at(group, name)[:].tolist() for name in ("bounds", "nodes"))
            error = float(value_at(group, "error"))
            depends_on = json.loads(text_of(value_at(group, "depends_on/data")))
            plan = json.loads(text_of(value_at(file, "truth/plan/data")))
        energies = PiecewiseChebyshev(tuple(bounds), tuple(counts))
        setting = f"{sum(counts)} energies of {bounds[0]:g} .. {bounds[-1]:g} keV from {Path(path).name}"
        last = Choice("kept projections", setting, error, SHARE * plan["tolerance"])
        traced = [Choice.from_dict(part) for part in plan["parts"] if part["part"] not in {"energies", last.part}]
        settings = Settings.from_dict(plan["settings"])
        return cls(Path(path), energies, (*traced, last), plan["tolerance"], settings, depends_on)

    @property
    def identity(self) -> str:
        """Digest that separates these projections from others; a file that was written again is another one."""
        about = self.path.stat()
        return digest((self.depends_on, self.energies, about.st_size, about.st_mtime_ns))

    def check(self, scan: Scan) -> None:
        """Refuse a scan that these are not the projections of.

        Parameters
        ----------
        scan : what is simulated

        Raises
        ------
        InputError
            With the keys that differ, or the energies that are missing.
        """
        found = fingerprint(scan, self.energies.nodes)
        other = [key for key, value in found.items() if self.depends_on.get(key) != value]
        if other:
            raise InputError(
                f"{self.path} keeps projections of another scan, as {' and '.join(other)} differ: leave these keys as "
                "they are there, or make the scan without --paths"
            )
        low, high = self.energies.bounds[0], self.energies.bounds[-1]
        lowest, highest = scan.detector.lowest, scan.source.maximum
        if lowest < low or highest > high:
            raise InputError(
                f"{self.path} keeps projections from {low:g} to {high:g} keV, but photons of {lowest:g} to {highest:g} "
                "keV are detected: keep them by a scan that detects these"
            )

    def planned(self, scan: Scan, tolerance: float) -> tuple[Plan, "CachedViews"]:
        """Plan a scan that is computed from the stored projections.

        Parameters
        ----------
        scan : what is simulated
        tolerance : worst error of log projections that is wanted

        Returns
        -------
        the plan, and the views
        """
        share, lengths = ENERGY * tolerance, sampled_lengths(scan)
        cuts, bins = fine_cuts(scan, lengths, BINS * share)
        exposure, error = Exposure.of(scan, lengths, (1 - BINS) * share, refine=False, cuts=cuts)
        groups, old = exposure.groups, len(scan.scene.materials)
        counts = " + ".join(str(n) for n in np.diff(exposure.transmission.starts))
        rows = np.arange(len(groups)) if exposure.quanta is None else exposure.channels
        shares = self.energies.matrix(node_energies(scan, groups, rows, cuts)).T
        through = attenuation(scan, self.energies.nodes) @ shares
        groups = replace(groups, columns=np.concatenate([through, groups.columns[old:]]))
        choices = (Choice("energies", f"{counts} nodes", bins + error, share), *self._choices(tolerance))
        plan = Plan(tolerance, scan, self.settings, replace(exposure, groups=groups), choices)
        return plan, CachedViews(self, scan, np.concatenate([shares, groups.columns[old:]]))

    def projections(self, view: int) -> Float32[np.ndarray, "energy row column"]:
        """Read the projections of one view.

        Parameters
        ----------
        view : number of the view

        Returns
        -------
        projections, (energy, row, column)
        """
        with h5py.File(self.path, "r") as file:
            return array_at(file, f"{GROUP}/data")[view]

    def fractions(self, scan: Scan) -> Callable[[Grid], Float32[np.ndarray, "material z y x"]] | None:
        """Return a function that reads the material fractions of a grid from the dataset, to 1/65535.

        Parameters
        ----------
        scan : what is simulated

        Returns
        -------
        the function; None where the dataset has other voxels
        """
        whole = scan.grid
        with h5py.File(self.path, "r") as file:
            wanted = {"shape": whole.shape, "spacing": whole.spacing, "origin": whole.origin}
            if any(tuple(value_at(file, f"truth/grid/{key}")) != value for key, value in wanted.items()):
                return None

        def fractions_on(part: Grid) -> Float32[np.ndarray, "material z y x"]:
            first = round((part.origin[0] - whole.origin[0]) / whole.spacing[0])
            with h5py.File(self.path, "r") as file:
                slab = array_at(file, "truth/fractions")[:, first : first + part.shape[0]]
            return slab.astype(np.float32) / np.float32(FRACTION_SCALE)

        return fractions_on

    def _choices(self, tolerance: float) -> tuple[Choice, ...]:
        """Parts of the plan, with shares of another tolerance."""
        factor = tolerance / self.tolerance
        return tuple(replace(choice, share=factor * choice.share) for choice in self.choices)


@dataclass(frozen=True, eq=False)
class CachedViews:
    """Views of a scan computed from stored projections.

    Parameters
    ----------
    kept : the projections
    scan : what is simulated
    columns : what each of them, and then each part of the beam's profile, adds to the exponent of each energy node
    """

    kept: ProjectionCache
    scan: Scan
    columns: Float[np.ndarray, "column node"]

    def primary(self, view: int, transmission: Transmission) -> Groups:
        """Compute the expected signals of a view, without scatter.

        Parameters
        ----------
        view : number of the view
        transmission : only its weights and channels are used

        Returns
        -------
        signals, (group, row, column)
        """
        lengths = self.kept.projections(view)
        if self.scan.profile is not None:
            lengths = np.concatenate([lengths, self.scan.profile.lengths])
        spectral = replace(transmission, columns=self.columns)
        return np.ascontiguousarray(np.moveaxis(spectral.expected(np.moveaxis(lengths, 0, -1)), -1, 0))


def usable(path: Path | str, scan: Scan, out: Path | str, keep: bool = False) -> ProjectionCache:
    """Return stored projections for a scan that is written to `out`.

    Parameters
    ----------
    path : dataset with projections
    scan : what is simulated
    out : dataset to be written
    keep : whether projections are to be stored in `out` as well

    Returns
    -------
    the projections

    Raises
    ------
    InputError
        When they are those of another scan, would be overwritten, or are asked to be kept again.
    """
    if keep:
        raise InputError(f"--keep paths traces rays, but --paths {path} says not to: leave out one of them")
    if Path(out).exists() and Path(path).exists() and Path(out).samefile(path):
        raise InputError(f"the output {out} is the file that --paths reads: choose another name by --out")
    kept = ProjectionCache.read(path)
    kept.check(scan)
    return kept


def fingerprint(scan: Scan, energy: Float[np.ndarray, " energy"]) -> dict[str, str]:
    """Compute digests of what projections depend on, under the names of keys of a scene.

    Parameters
    ----------
    scan : what is simulated
    energy : energies of the projections [keV]

    Returns
    -------
    digests by name
    """
    panel = scan.geometry.panel
    return {
        "objects": digest(scan.scene.solids),
        "materials": digest((attenuation(scan, energy), scan.scene.background)),
        "geometry or panel": digest((scan.by_module.geometry.ray_frames(), panel.rows, panel.columns, scan.sub_rays)),
        "effects.focal_spot": digest(scan.effects.focal_spot),
        "effects.aperture": digest(scan.effects.aperture),
    }


def cached_scene(path: Path | str, overrides: Sequence[str] = ()) -> SceneFile:
    """Read the scene of a dataset that stores projections, random values drawn.

    Files that the scene names lie beside the dataset.

    Parameters
    ----------
    path : the dataset
    overrides : ``path=value`` with dotted paths

    Returns
    -------
    the scene file

    Raises
    ------
    DatasetError
        When it is no dataset, or keeps no projections.
    """
    with _opened(path) as file:
        group_at(file, GROUP)
        return SceneFile(str(path), text_of(value_at(file, "truth/scene/data")), tuple(overrides))


@contextmanager
def _opened(path: Path | str) -> Iterator[h5py.File]:
    """A dataset that keeps projections."""
    with open_file(Path(path), "truth") as file:
        if GROUP not in file:
            raise DatasetError(f"{path} keeps no projections: make it with --keep paths")
        yield file
