"""How photons are scattered: what ``--scatter`` asks for."""

from dataclasses import dataclass

import numpy as np

from phantomgen.effects.scatter import ScatterKernel
from spectra.errors import InputError

FIRST_RATIO = 0.1  # scatter over primary signal that a fit begins with; chosen by hand, not measured


@dataclass(frozen=True)
class Compton:
    """Single Compton scatter of the reconstructed object.

    Parameters
    ----------
    factors : of the computed scatter, one for all channels or one for each, such as what a grid lets through, or above
        1 for multiple scatter; None for those that explain the counts best
    each_channel : whether each channel has a factor of its own where they are fitted

    Raises
    ------
    InputError
        When a factor is negative or not finite.
    """

    factors: tuple[float, ...] | None = (1.0,)
    each_channel: bool = False

    def __post_init__(self) -> None:
        for factor in self.factors or ():
            if not 0 <= factor < np.inf:
                raise InputError(f"a factor of scatter must be finite and not negative, got {factor:g}")


@dataclass(frozen=True)
class FittedKernel:
    """A kernel of known width whose ratio of scatter to primary signal is fitted to the counts.

    Parameters
    ----------
    width : full width at half maximum [mm]
    each_channel : whether each channel has a ratio of its own

    Raises
    ------
    InputError
        When the width is not positive.
    """

    width: float
    each_channel: bool = False

    def __post_init__(self) -> None:
        ScatterKernel(FIRST_RATIO, self.width)  # which checks the width


ScatterModel = Compton | FittedKernel | ScatterKernel
