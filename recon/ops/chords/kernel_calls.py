"""Calls of the kernels: views, bands and slices are shared between the threads as in the rasterizer."""

import numpy as np
from jaxtyping import Float
from torch import Tensor

from phantomgen.geometry.voxel_grid import Grid
from recon.ops.arguments import GaussianGradients, GaussianTensors, RayFrame, lattice_of
from recon.ops.chords import cpu
from recon.ops.pieces import run_in_pieces
from recon.ops.rasterize.cpu import whitening
from recon.ops.rasterize.cpu_calls import RasterizeCall
from recon.ops.rasterize.footprint_table import Views
from recon.ops.rasterize.projector import Projector

PARTS = 2  # sample points per edge of a voxel
SLICES = 8  # per piece of work
AT_CENTRES = Projector(footprint=0.0, cutoff=1.0)  # rays through pixel centres; an ellipsoid ends at its semi-axes


class ChordCall(RasterizeCall):
    """Arrays of one call of `recon.ops.chords.chords`.

    Parameters
    ----------
    parts : ellipsoids; `log_scales` are logarithms of their semi-axes
    frames : per view source, d0, column step and row step [mm]
    panel : rows and columns
    smooth : as in `recon.ops.chords.chords`
    """

    def __init__(self, parts: GaussianTensors, frames: Tensor, panel: tuple[int, int], smooth: float) -> None:
        super().__init__(parts, frames, panel, AT_CENTRES)
        self.smooth = smooth

    def _footprints(self, view: RayFrame, first: int, last: int, table: np.ndarray) -> None:
        cpu.footprints(self.gaussians, view, self.panel[0], first, last, table)

    def _add_rows(
        self, view: RayFrame, table: np.ndarray, lengths: np.ndarray, rows: tuple[int, int], image: np.ndarray
    ) -> None:
        cpu.forward(table, self.gaussians.coefficients, lengths, self.smooth, *rows, image)

    def _add_gradients(
        self, views: Views, padded: np.ndarray, first: int, last: int, gradients: GaussianGradients
    ) -> None:
        cpu.backward(self.gaussians, views, padded, self.smooth, first, last, gradients)


def fill(
    centres: Float[Tensor, "ellipsoid 3"],
    log_axes: Float[Tensor, "ellipsoid 3"],
    quaternions: Float[Tensor, "ellipsoid 4"],
    values: Float[Tensor, " ellipsoid"],
    grid: Grid,
    parts: int = PARTS,
) -> Float[np.ndarray, "z y x"]:
    """Compute the volume of ellipsoids of constant attenuation; values add up where ellipsoids overlap.

    Parameters
    ----------
    centres, log_axes, quaternions : as in `recon.ops.chords.chords`
    values : attenuation inside [1/mm]
    grid : voxels to fill
    parts : sample points per edge of a voxel; the part of the parts^3 points that lie inside is the part of the voxel

    Returns
    -------
    attenuation of each voxel [1/mm], float32
    """
    middles, axes, turns, inside = (
        x.detach().numpy().astype(np.float64) for x in (centres, log_axes, quaternions, values)
    )
    matrices = np.empty((len(middles), 3, 3))
    whitening(axes, turns, 0, len(middles), matrices)
    lattice = lattice_of(grid)
    out = np.zeros(grid.shape)
    run_in_pieces(
        lambda first, last: cpu.fill(middles, matrices, inside, lattice, parts, first, last, out), len(out), SLICES
    )
    return out.astype(np.float32)
