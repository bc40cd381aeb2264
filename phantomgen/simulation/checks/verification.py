"""How wrong the expected counts are: against many rays per pixel and ten times finer energy bins.

The reference shares the exact chords with the simulator, and neither its way of averaging over a pixel nor its energy
nodes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from phantomgen.ops.expected_counts import CROSSED, VOXELS, Sampling, expected_counts, expected_counts_by_grid
from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.reference_rays import log_errors
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.energy_grids import STEP, compressed_transmission, fine_transmission
from phantomgen.simulation.forward_model.expected_counts import expected_view, spectrum_of
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from spectra.threads import run_parallel
from spectra.transmission import Transmission

# Rays along each edge of a pixel of the reference.
SUB_RAYS = 256
# With a focal spot, fewer rays per pixel from so many of its points.
SPOT_RAYS, SPOT_POINTS = 24, 985
# How many times finer the energy bins of the reference are than those of the simulator.
FINER = 10
# Edge pixels and rays of the quick check, about a second; views and rays of the full one, which takes minutes.
_QUICK_PIXELS, _QUICK_RAYS = 24, 2000
_FULL_VIEWS, _FULL_RAYS = 3, 100_000
# Pixels per piece of work of a thread; changes time, not results.
_PIXELS_PER_PIECE = 8
# Of the pixels that voxel maps project to, which may be all, no more than these are looked at per view.
_MOST_VOXEL_PIXELS = 200
# Nodes of the reference may err by this.
_ENERGY_TOLERANCE = 1e-6

Errors = Float[np.ndarray, " value"]
Counts = Float[np.ndarray, "sample channel"]
Pixels = Int[np.ndarray, "pixel 2"]
# From a view, and the energies and channels of its signal, to that signal.
Primary = Callable[[int, Transmission], np.ndarray]


@dataclass(frozen=True)
class MeasuredError:
    """Error of the log projection.

    Parameters
    ----------
    edge_rms, edge_worst : of edge pixels, against `sub_rays` x `sub_rays` rays and finer energies
    edge_pixels, views : how many pixels, of how many views
    ray_rms, ray_worst : of single rays, against `FINER` times finer energy bins
    rays : how many rays
    sub_rays : root of their number per pixel
    """

    edge_rms: float
    edge_worst: float
    edge_pixels: int
    views: int
    ray_rms: float
    ray_worst: float
    rays: int
    sub_rays: int = SUB_RAYS

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return dict(vars(self))

    def __str__(self) -> str:
        return (
            f"log projection against {self.sub_rays} x {self.sub_rays} sub-rays and {FINER}x energies:\n"
            f"         {self.edge_pixels} edge pixels of {self.views} views rms {self.edge_rms:.1e}, worst "
            f"{self.edge_worst:.1e}; {self.rays} random rays rms {self.ray_rms:.1e}, worst {self.ray_worst:.1e}"
        )


def quick_check(
    scan: Scan, transmission: Transmission, settings: Settings, primary: Primary | None = None
) -> MeasuredError:
    """Measure the error on a seeded sample of edge pixels and rays, in about a second.

    Parameters
    ----------
    scan : the scan
    transmission : path lengths to counts
    settings : how finely it is computed
    primary : function that returns primary signals of a view in place of rays; None where rays are traced

    Returns
    -------
    the error
    """
    return _check(scan, transmission, settings, _QUICK_PIXELS, _QUICK_RAYS, primary)


def full_check(
    scan: Scan, transmission: Transmission, settings: Settings, primary: Primary | None = None
) -> MeasuredError:
    """Measure the error on all edge pixels of three views and on 1e5 rays.

    Parameters
    ----------
    scan : the scan
    transmission : path lengths to counts
    settings : how finely it is computed
    primary : function that returns primary signals of a view in place of rays; None where rays are traced

    Returns
    -------
    the error
    """
    return _check(scan, transmission, settings, None, _FULL_RAYS, primary)


def _check(
    scan: Scan,
    transmission: Transmission,
    settings: Settings,
    pixels_per_scan: int | None,
    rays: int,
    primary: Primary | None = None,
) -> MeasuredError:
    """Errors of edge pixels and of rays; all edge pixels where no number of them is given."""
    rng = np.random.default_rng([scan.seed, 6])
    views = np.linspace(0, len(scan.geometry) - 1, min(_FULL_VIEWS, len(scan.geometry))).round().astype(int)
    reference, _ = compressed_transmission(
        scan, sampled_lengths(scan), _ENERGY_TOLERANCE, refine=False, step=STEP / FINER
    )
    share = None if pixels_per_scan is None else -(-pixels_per_scan // len(views))
    modules = scan.geometry.panel.modules
    numbers = [view * modules + module for view in views.tolist() for module in _some_modules(modules, share, rng)]
    edge = np.concatenate(
        [_edge_errors(scan, transmission, settings, reference, n, share, rng, primary) for n in numbers]
    )
    ray = _ray_errors(scan, transmission, rays, rng)
    counted = len(edge) // len(scan.detector)
    return MeasuredError(*_rms_and_worst(edge), counted, len(views), *_rms_and_worst(ray), rays, _sub_rays(scan))


def _some_modules(modules: int, count: int | None, rng: np.random.Generator) -> list[int]:
    """All modules of a panel, or as many as pixels are wanted."""
    if modules == 1:
        return [0]
    order = rng.permutation(modules)
    return sorted(order[: count or modules].tolist())


def _edge_errors(
    scan: Scan,
    transmission: Transmission,
    settings: Settings,
    reference: Transmission,
    view: int,
    count: int | None,
    rng: np.random.Generator,
    primary: Primary | None = None,
) -> Errors:
    """Errors of all edge pixels of a view of `Scan.by_module`, or of `count` of them."""
    whole, scan = scan, scan.by_module.instant(view)
    frame, panel = scan.geometry[[view]].ray_frames()[0], scan.geometry.panel
    beam = scan.scene.solids, spectrum_of(scan, transmission, view), scan.scene.background
    found = expected_counts(frame, panel.rows, panel.columns, *beam, settings.sampling(scan.aperture))
    if settings.sub_rays == 1:  # rays through centres find no edges
        edges = expected_counts(frame, panel.rows, panel.columns, *beam, Sampling(sub_rays=2))
        found = found._replace(classes=edges.classes)
    pixels, mapped = np.argwhere((found.classes >= CROSSED) & (found.classes != VOXELS)), found.classes == VOXELS
    if mapped.any():
        chosen = np.argwhere(mapped)
        chosen = chosen[rng.choice(len(chosen), min(len(chosen), _MOST_VOXEL_PIXELS), replace=False)]
        pixels = np.concatenate([pixels, chosen])
    if count is not None and len(pixels) > count:
        pixels = pixels[rng.choice(len(pixels), count, replace=False)]
    brute = _brute(scan, reference, view, frame, pixels)
    counts = found.counts[:, pixels[:, 0], pixels[:, 1]].T
    number, module = divmod(view, whole.geometry.panel.modules)
    on_whole = pixels + np.array([0, module * panel.columns])
    if primary is not None or scan.effects.focal_spot is not None:
        image = (
            expected_view(whole, transmission, number, settings) if primary is None else primary(number, transmission)
        )
        counts = image[:, on_whole[:, 0], on_whole[:, 1]].T
    left, wanted = counts / _level(scan, transmission, on_whole), brute / _level(scan, reference, on_whole)
    return log_errors(left, wanted, 1 / _sub_rays(scan)).ravel()


def _brute(
    scan: Scan, reference: Transmission, view: int, frame: Float[np.ndarray, "4 3"], pixels: Pixels
) -> np.ndarray:
    """Counts of pixels from a lattice of rays from each point of the source, in parallel pieces."""
    spot = scan.effects.focal_spot
    frames = [frame] if spot is None else spot.frames(frame, SPOT_POINTS)
    beam = scan.scene.solids, spectrum_of(scan, reference, view), scan.scene.background
    grid = _sub_rays(scan), scan.aperture, True

    def piece(part: Pixels) -> np.ndarray:
        return np.mean([expected_counts_by_grid(f, part, *beam, *grid) for f in frames], axis=0)

    parts = [pixels[first : first + _PIXELS_PER_PIECE] for first in range(0, len(pixels), _PIXELS_PER_PIECE)]
    return np.concatenate([np.empty((0, len(scan.detector))), *run_parallel(piece, parts)])


def _sub_rays(scan: Scan) -> int:
    """Root of the number of rays of the reference per pixel."""
    return SUB_RAYS if scan.effects.focal_spot is None else SPOT_RAYS


def _ray_errors(scan: Scan, transmission: Transmission, count: int, rng: np.random.Generator) -> Errors:
    """Errors of random rays of random views, against all bins of the finer energy grid."""
    frames, panel = scan.by_module.geometry.ray_frames(), scan.by_module.geometry.panel
    view = rng.integers(len(frames), size=count)
    frame = frames[view]
    column, row = rng.uniform(-0.5, panel.columns - 0.5, count), rng.uniform(-0.5, panel.rows - 0.5, count)
    directions = frame[:, 1] + column[:, None] * frame[:, 2] + row[:, None] * frame[:, 3]
    lengths = _path_lengths(scan.by_module, view, frame[:, 0], directions)
    met = lengths.any(axis=1)
    pixels = np.rint(np.stack([row[met], column[met]], axis=1)).astype(int)
    pixels[:, 1] += (view[met] % scan.geometry.panel.modules) * panel.columns
    lengths = _beside_profile(scan, lengths[met], pixels)
    exact = fine_transmission(scan, step=STEP / FINER)
    left, wanted = (t.expected(lengths) / _level(scan, t, pixels) for t in (transmission, exact))
    return log_errors(left, wanted).ravel()


def _path_lengths(
    scan: Scan,
    view: Int[np.ndarray, " ray"],
    origins: Float[np.ndarray, "ray 3"],
    directions: Float[np.ndarray, "ray 3"],
) -> Float[np.ndarray, "ray material"]:
    """Path lengths of rays, each with the objects where they are in its view [mm]."""
    if scan.dynamics is None:
        return scan.scene.path_lengths(origins, directions)
    lengths = np.empty((len(view), len(scan.scene.materials)))
    for number in np.unique(view).tolist():
        own = view == number
        lengths[own] = scan.instant(number).scene.path_lengths(origins[own], directions[own])
    return lengths


def _beside_profile(
    scan: Scan, lengths: Float[np.ndarray, "ray material"], pixels: Pixels
) -> Float[np.ndarray, "ray material_and_part"]:
    """Path lengths in materials, and those that rays to these pixels have in the beam's profile."""
    if scan.profile is None:
        return lengths
    return np.hstack([lengths, scan.profile.lengths[:, pixels[:, 0], pixels[:, 1]].T])


def _level(scan: Scan, transmission: Transmission, pixels: Pixels) -> Counts:
    """Open-beam counts of pixels; infinite for a blind channel, whose counts then are nothing."""
    air = transmission.open_beam[None]
    if scan.profile is not None:
        nothing = np.zeros((len(pixels), len(scan.scene.materials)))
        air = transmission.expected(_beside_profile(scan, nothing, pixels))
    return np.where(air > 0, air, np.inf)


def _rms_and_worst(errors: Errors) -> tuple[float, float]:
    """Root mean square and largest size."""
    return float(np.sqrt(np.mean(errors**2))) if len(errors) else 0.0, float(np.abs(errors).max(initial=0.0))
