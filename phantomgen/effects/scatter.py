"""Scattered photons: as a smooth kernel, or as single Compton scatter.

Kernel: the forward scatter of Ohnesorge, Flohr & Klingenbeck-Regn 1999 (Eur Radiol 9:563, doi:10.1007/s003300050710).
What a ray scatters in the forward direction is proportional to p exp(-p) I0 with the log projection p of that ray; a
normal distribution spreads it over the panel. Each channel scatters into itself. Its strength is one number, the same
in all views and channels, such that scattered and primary signal have a given ratio in the shadow of the objects in the
first view, all channels together. Objects beyond the panel do not scatter; flats and darks hold no scatter.

Sources of scatter are averaged over blocks of pixels, at least eight to a standard deviation of the kernel, and the
kernel is integrated over each block exactly, so what is scattered is what arrives on an endless panel.

Single Compton scatter: photons on their way from the source are weakened up to a point of the object, are scattered
there by the angle theta with the cross section of free electrons at rest (Klein & Nishina 1929,
doi:10.1007/BF01366453), have less energy from then on, and are weakened on the way to the panel:

    k = 1 / (1 + (E / 511 keV) (1 - cos theta)),   E' = k E
    d sigma / d Omega = r_e^2 / 2  k^2 (k + 1/k - sin^2 theta)

Left out: photons that scatter more than once, coherent scatter, the binding of electrons, and what lies beyond the
panel's beam or the volume. Flats hold no scatter.

One random point stands for all electrons in each cell of a coarse grid, which errs less than their centre does, as
photons are weakened by very different amounts within a cell; `phantomgen.ops.compton` sums over them. The result is
smooth: it is computed at few places of the panel, and splines give the pixels.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.special import ndtr

from phantomgen.effects.focal_spot import FWHM
from phantomgen.geometry.curved_panel import on_panel
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.errors import InputError

Images = Float[np.ndarray, "group row column"]
# Pixels whose log projection exceeds this lie in the shadow of an object.
SHADOW = 0.01
# Blocks of pixels per standard deviation of the kernel, whose scatter is summed as one.
_BLOCKS = 8


@dataclass(frozen=True)
class ScatterKernel:
    """Smooth scatter that is estimated from the primary signal by a kernel.

    Parameters
    ----------
    ratio : of scattered to primary signal in the shadow of the objects
    width : full width at half maximum of the kernel on the panel [mm]

    Raises
    ------
    InputError
        When the ratio is negative, or the width is not positive.
    """

    ratio: float
    width: float

    def __post_init__(self) -> None:
        if not 0 <= self.ratio < np.inf:
            raise InputError(f"the ratio of scatter to primary must be finite and not negative, got {self.ratio:g}")
        if not 0 < self.width < np.inf:
            raise InputError(f"the width of a scatter kernel must be positive, got {self.width:g} mm")

    def spread(self, primary: Images, open_beam: Images, panel: Panel) -> Images:
        """Compute the scatter of strength 1: p exp(-p) I0 of each group, spread over the panel.

        Parameters
        ----------
        primary : primary signals, (group, row, column)
        open_beam : signals without object, (group, row, column)
        panel : the pixel grid

        Returns
        -------
        scattered signals, (group, row, column)
        """
        part = np.divide(primary, open_beam, out=np.ones_like(primary), where=open_beam > 0)
        sources = -primary * np.log(np.clip(part, 1e-300, 1.0))
        sigma = self.width / FWHM
        return _spread_rows(_spread_rows(sources, panel.column_pitch, sigma), panel.row_pitch, sigma)

    def strength(self, primary: Images, open_beam: Images, panel: Panel) -> float:
        """Compute the factor on `spread` that gives the required ratio in one view.

        Parameters
        ----------
        primary : primary signals, (group, row, column)
        open_beam : signals without object, (group, row, column)
        panel : the pixel grid

        Returns
        -------
        factor; 0 where no object casts a shadow
        """
        total, air = primary.sum(axis=0), open_beam.sum(axis=0)
        shadow = total < air * np.exp(-SHADOW)
        scattered = self.spread(primary, open_beam, panel).sum(axis=0)[shadow].sum()
        return self.ratio * float(total[shadow].sum() / scattered) if scattered > 0 else 0.0


def _spread_rows(images: Images, pitch: float, sigma: float) -> Float[np.ndarray, "group column row"]:
    """Spread along rows, and transpose; sums in a fixed order, whatever the number of threads."""
    firsts = np.arange(0, images.shape[2], max(1, int(sigma / (_BLOCKS * pitch))))
    edges = np.append(firsts, images.shape[2])
    below = ndtr((edges[:, None] - 0.5 - np.arange(images.shape[2])) * (pitch / sigma))
    arriving = np.diff(below, axis=0) / np.diff(edges)[:, None]
    return np.einsum("grb,bc->gcr", np.add.reduceat(images, firsts, axis=2), arriving)


@dataclass(frozen=True)
class ComptonScatter:
    """Single Compton scatter of the scene's own objects and photons; it has no parameters."""


def scatterers(
    density: Float[np.ndarray, "z y x"], grid: Grid, cells: int, rng: np.random.RandomState
) -> tuple[Float[np.ndarray, "point 3"], Float[np.ndarray, " point"]]:
    """Draw a random place in each of `cells`^3 blocks that contains anything, and sum the content of the block.

    Parameters
    ----------
    density : per volume [1/mm^3]; where there is more, the place is more likely
    grid : of the voxels, whose number along each axis is a multiple of `cells`
    cells : along each axis
    rng : random numbers

    Returns
    -------
    places (x, y, z) [mm], and content of their blocks
    """
    block = [n for size in density.shape for n in (cells, size // cells)]
    held = (density * grid.voxel_volume).reshape(block).transpose(0, 2, 4, 1, 3, 5).reshape(cells**3, -1)
    upto = np.cumsum(held, axis=1)
    some = np.flatnonzero(upto[:, -1] > 0)
    wish = rng.random_sample(len(some)) * upto[some, -1]
    voxel = (upto[some] <= wish[:, None]).sum(axis=1)
    index = np.array(np.unravel_index(some, (cells,) * 3)) * np.array([block[1::2]]).T
    index += np.array(np.unravel_index(voxel, block[1::2]))
    zyx = (index.T + rng.random_sample((len(some), 3)) - 0.5) * grid.spacing + grid.origin
    return np.ascontiguousarray(zyx[:, ::-1]), upto[some, -1]


def in_beam(
    geometry: Geometry, view: int, place: Float[np.ndarray, "point 3"]
) -> tuple[Bool[np.ndarray, " point"], Int[np.ndarray, "2 lit"]]:
    """Find the points in the beam between source and panel, and project them.

    Parameters
    ----------
    geometry : poses
    view : number of the view
    place : points [mm], (point, 3)

    Returns
    -------
    True for points in the beam, and row and column of the pixels that those points fall on
    """
    (depth, column, row), panel = on_panel(geometry[[view]], place)[0].T, geometry.panel
    lit = (depth > 0) & (depth < 1) & (np.abs(column - (panel.columns - 1) / 2) < panel.columns / 2)
    lit &= np.abs(row - (panel.rows - 1) / 2) < panel.rows / 2
    pixel = np.rint(np.stack([row, column])[:, lit]).astype(np.int64)
    return lit, pixel.clip(0, [[panel.rows - 1], [panel.columns - 1]])
