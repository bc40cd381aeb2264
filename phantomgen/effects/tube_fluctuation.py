"""Tube output that differs from exposure to exposure: by chance, and as the scanner asks for.

Fluctuation: every view and every flat has its own factor on all photons, normal around 1 with a standard deviation
`sigma`, independent of all others. A monitor may record the factors; a reconstructor without them has to estimate them
in air.

Modulation: the scanner sets the tube current of each view by the attenuation that a topogram shows, with
``factor ~ exp(strength * A)``, A the logarithm of the attenuation of the darkest part of the view.

References
----------
.. [1] Gies, Kalender, Wolf, Suess & Madsen 1999, Med. Phys. 26, 2235: a current that follows the root of the
   attenuation gives the least noise for a given sum of the current
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

BEST_STRENGTH = 0.5  # exponent of the attenuation that gives the least noise [1]_
# Largest standard deviation of the tube's output, no unit.
_LARGEST = 0.2


@dataclass(frozen=True)
class TubeOutput:
    """Fluctuation of the tube output between exposures.

    Parameters
    ----------
    sigma : standard deviation of the factors, at most 0.2
    recorded : whether the dataset tells the factors of views

    Raises
    ------
    InputError
        When `sigma` is negative or so large that an output may be negative.
    """

    sigma: float
    recorded: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.sigma <= _LARGEST:
            raise InputError(f"the standard deviation of tube output must lie in 0 .. {_LARGEST}, got {self.sigma:g}")

    def factors(self, seed: int, stream: Stream, frames: int) -> Float[np.ndarray, " frame"]:
        """Draw the output of each frame, relative to the mean.

        The factor of a frame does not depend on the number of frames.

        Parameters
        ----------
        seed : of the scan
        stream : views or flats
        frames : number of frames

        Returns
        -------
        one factor per frame
        """
        drawn = [generator(seed, Stream.TUBE, frame, int(stream)).standard_normal() for frame in range(frames)]
        return np.maximum(1 + self.sigma * np.array(drawn), 0.0)


@dataclass(frozen=True)
class CurrentModulation:
    """Tube current that follows the attenuation of each view, or stated factors.

    Parameters
    ----------
    strength : exponent of the attenuation, 0 to 1
    least, most : limits of the factors, relative to their mean
    factors : factor of each view, in place of those that follow the attenuation

    Raises
    ------
    InputError
        When a limit excludes the mean, or a factor is not positive.
    """

    strength: float = BEST_STRENGTH
    least: float = 0.1
    most: float = 10.0
    factors: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if not 0 < self.least <= 1 <= self.most:
            raise InputError(
                "limits of the tube current must be above 0 and include its mean, 1, "
                f"got {self.least:g} to {self.most:g}"
            )

    def of(self, attenuation: Float[np.ndarray, " view"]) -> Float[np.ndarray, " view"]:
        """Compute the factor of each view, whose mean is 1 but for factors that are stated.

        Parameters
        ----------
        attenuation : logarithm of the attenuation of each view

        Returns
        -------
        factors on the photons of each view

        Raises
        ------
        InputError
            When the number of stated factors is not that of the views.
        """
        if self.factors is not None:
            if len(self.factors) != len(attenuation):
                raise InputError(
                    f"the scan has {len(attenuation)} views, test views included: state as many factors of the tube "
                    f"current, got {len(self.factors)}"
                )
            return np.array(self.factors, dtype=np.float64)
        wanted = np.exp(self.strength * (attenuation - attenuation.max()))
        limited = np.clip(wanted / wanted.mean(), self.least, self.most)
        return limited / limited.mean()
