"""Scatter as a smooth cloud around where the beam is attenuated.

Model: the forward scatter of Ohnesorge, Flohr & Klingenbeck-Regn 1999 (Eur Radiol 9:563, doi:10.1007/s003300050710).
What a ray scatters in the forward direction is proportional to p exp(-p) I0 with the log projection p of that ray; a
normal distribution spreads it over the panel. Each channel scatters into itself. Its strength is one number, the same
in all views and channels, such that scattered and primary signal have a given ratio in the shadow of the objects in the
first view, all channels together. Objects beyond the panel do not scatter; flats and darks hold no scatter.

Sources of scatter are averaged over blocks of pixels, at least eight to a standard deviation of the kernel, and the
kernel is integrated over each block exactly, so what is scattered is what arrives on an endless panel.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr

from phantomgen.effects.focal_spot import FWHM
from phantomgen.geometry.panel import Panel
from spectra.errors import InputError

Images = Float[np.ndarray, "group row column"]
# Pixels whose log projection exceeds this lie in the shadow of an object.
SHADOW = 0.01
_BLOCKS = 8


@dataclass(frozen=True)
class ScatterKernel:
    """Smooth scatter that is estimated from the primary signal.

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
        """Scatter of strength 1: p exp(-p) I0 of each group, spread over the panel."""
        part = np.divide(primary, open_beam, out=np.ones_like(primary), where=open_beam > 0)
        sources = -primary * np.log(np.clip(part, 1e-300, 1.0))
        sigma = self.width / FWHM
        return _spread_rows(_spread_rows(sources, panel.column_pitch, sigma), panel.row_pitch, sigma)

    def strength(self, primary: Images, open_beam: Images, panel: Panel) -> float:
        """Factor on `spread` that gives the ratio asked for in one view; 0 where no object casts a shadow."""
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
