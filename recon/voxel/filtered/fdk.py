"""Filtered back-projection of cone-beam data (Feldkamp, Davis, Kress 1984, doi:10.1364/JOSAA.1.000612).

Full circles, half-fan panels that see one side of the axis only, short scans of half a turn and the fan, tilted and
curved panels, and parallel beams; `recon.voxel.filtered.circular_orbit` says which orbits those are.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.flat_panel import on_flat_panel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.data.array_store import read_part
from recon.ops.backproject import backproject
from recon.voxel.filtered.circular_orbit import CircularOrbit, circular_orbit_of
from recon.voxel.filtered.ramp_filter import WINDOWS, ramp_filtered
from recon.voxel.filtered.redundancy_weights import half_fan_weights, parker_weights
from recon.voxel.filtered.z_aligned_panel import on_z_aligned_panel
from recon.voxel.method import Images, Iteration, OnIteration, Volumes, Weights, no_callback
from spectra.errors import InputError


@dataclass(frozen=True)
class Fdk:
    """Filtered back-projection as a method; weights of rays are ignored.

    Parameters
    ----------
    window : window of the ramp filter, see `fdk`; ``cosine`` by `benchmarks.reconstruction.comparison_methods`
    cutoff : cutoff of the window [Nyquist frequencies]
    """

    window: str = "cosine"
    cutoff: float = 1.0

    @property
    def name(self) -> str:
        """Name of the method, as in ``--method``."""
        return "fdk"

    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = no_callback,
    ) -> Volumes:
        """Reconstruct volumes from line integrals.

        Parameters
        ----------
        line_integrals : one image per basis and view [no unit]
        weights : ignored
        geometry : circular orbit, see `recon.voxel.filtered.circular_orbit`
        grid : the volume to reconstruct
        on_iteration : called once

        Returns
        -------
        volumes of the bases [1/mm]
        """
        del weights
        volumes = fdk(np.moveaxis(line_integrals, 0, 1), geometry, grid, self.window, self.cutoff)
        on_iteration(Iteration(1, 1, 0.0, volumes))
        return volumes


VIEWS_AT_ONCE = 16  # views; filtered and back-projected together, which bounds the memory


def fdk(
    line_integrals: Float[np.ndarray, "view basis row column"],
    geometry: Geometry,
    grid: Grid,
    window: str = "hann",
    cutoff: float = 1.0,
) -> Float[np.ndarray, "basis z y x"]:
    """Reconstruct volumes from line integrals on a circular orbit of evenly spaced views.

    Parameters
    ----------
    line_integrals : one image per view and basis [no unit]
    geometry : circular orbit about the z axis, full or at least half a turn and the fan
    grid : the volume to reconstruct
    window : window of the ramp filter: ``ram-lak`` (none), ``shepp-logan``, ``cosine`` or ``hann``
    cutoff : frequency above which the filter is zero [Nyquist frequencies]

    Returns
    -------
    volumes of the bases [1/mm]

    Raises
    ------
    InputError
        When there is no such window, or the cutoff is not above 0.
    GeometryError
        When the geometry is not such an orbit.
    """
    if window not in WINDOWS or not cutoff > 0:
        known = ", ".join(WINDOWS)
        raise InputError(f"a filter is a window ({known}) and a cutoff above 0, got {window!r} and {cutoff}")
    line_integrals, geometry = on_flat_panel(line_integrals, geometry)
    circle = circular_orbit_of(geometry, grid)
    if not circle.is_z_aligned:
        line_integrals, geometry = on_z_aligned_panel(line_integrals, geometry, circle)
        circle = circular_orbit_of(geometry, grid)
    if not circle.is_centred:
        line_integrals, geometry = _half_fan(line_integrals, geometry, circle)
    weights = _cosines(geometry)
    if not circle.is_full:
        weights = weights * _parker(geometry, circle)[:, None]
    pitch = geometry.panel.column_pitch * circle.sod[0] / circle.sdd[0]  # at the isocentre
    volume = np.zeros((line_integrals.shape[1], *grid.shape), np.float32)
    for first in range(0, len(geometry), VIEWS_AT_ONCE):
        some = slice(first, first + VIEWS_AT_ONCE)
        filtered = ramp_filtered(read_part(line_integrals, some) * weights[some, None], pitch, window, cutoff)
        volume = backproject(filtered, geometry[some], grid, (circle.sod / circle.sdd)[some], volume)
    return volume * np.float32(circle.arc / len(geometry))


def _cosines(geometry: Geometry) -> Float[np.ndarray, "view row column"]:
    """Cosine of the angle between each ray and the normal of the panel."""
    rows, columns = geometry.panel.rows, geometry.panel.columns
    out = np.empty((len(geometry), rows, columns), np.float32)
    for i, (frame, normal) in enumerate(zip(geometry.ray_frames(), geometry.normals(), strict=True)):
        x, y = np.arange(columns)[None, :, None], np.arange(rows)[:, None, None]
        rays = frame[1] + x * frame[2] + y * frame[3]
        out[i] = np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)
    return out


def _half_fan(
    images: Float[np.ndarray, "view basis row column"], geometry: Geometry, circle: CircularOrbit
) -> tuple[Float[np.ndarray, "view basis row wide_column"], Geometry]:
    """Weighted images on a panel made symmetric by columns of zeros, which receive the tails of the filter."""
    columns, pitch = geometry.panel.columns, geometry.panel.column_pitch
    across = (np.arange(columns) - circle.middle[:, None]) * pitch
    low, high = circle.middle.min() + 0.5, columns - 0.5 - circle.middle.max()
    side = 1.0 if low < high else -1.0
    weights = half_fan_weights(side * across, min(low, high) * pitch, float(circle.sdd[0])).astype(np.float32)
    missing = int(np.ceil(abs(high - low)))
    widths = (missing, 0) if side > 0 else (0, missing)
    wide = np.pad(images * weights[:, None, None], [(0, 0)] * 3 + [widths])
    panel = Panel(geometry.panel.rows, columns + missing, geometry.panel.pitch)
    center = geometry.panel_center - side * missing / 2 * geometry.column_step
    return wide, replace(geometry, panel_center=center, panel=panel)


def _parker(geometry: Geometry, circle: CircularOrbit) -> Float[np.ndarray, "view column"]:
    """Redundancy weights of a short scan."""
    counter_clockwise = np.cross([0.0, 0.0, 1.0], circle.outward)
    steps = np.einsum("vi,vi->v", geometry.column_step, counter_clockwise)
    across = (np.arange(geometry.panel.columns) - circle.middle[:, None]) * steps[:, None]
    fan = np.arctan(across / circle.sdd[:, None])
    return parker_weights(circle.angles, fan, circle.spare).astype(np.float32)
