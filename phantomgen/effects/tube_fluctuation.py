"""Tube output that varies from exposure to exposure.

Model: every view and every flat has its own factor on all photons, normal around 1 with a standard deviation `sigma`,
independent of all others. A monitor may record the factors; a reconstructor without them has to estimate them in
air.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

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
