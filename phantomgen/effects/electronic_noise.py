"""Electronic noise of energy-integrating detectors: an offset, and noise of every reading.

Model: a reading is the signal plus a constant offset plus a normal number of standard deviation `sigma`, independent
from pixel to pixel and from frame to frame (Whiting et al. 2006, doi:10.1118/1.2230762). Dark frames hold the offset
and noise of their own. Near zero signal a reading may be negative; it is stored as it is.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from phantomgen.effects.random_streams import Stream, generator
from spectra.errors import InputError

_STREAM = {
    Stream.PROJECTION: Stream.PROJECTION_READING,
    Stream.FLAT: Stream.FLAT_READING,
    Stream.DARK: Stream.DARK,
}


@dataclass(frozen=True)
class ElectronicNoise:
    """Offset and electronic noise of readings.

    Parameters
    ----------
    sigma : standard deviation of the noise [keV]
    offset : what a reading shows without beam [keV]

    Raises
    ------
    InputError
        When either is negative or not finite.
    """

    sigma: float
    offset: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("noise", self.sigma), ("offset", self.offset)):
            if not 0 <= value < np.inf:
                raise InputError(f"the {name} of electronics must be finite and not negative, got {value:g} keV")

    def reading(
        self,
        signal: Float[np.ndarray, "row column"],
        seed: int,
        frame: int,
        channel: int,
        stream: Stream = Stream.PROJECTION,
    ) -> Float[np.ndarray, "row column"]:
        """Draw the reading of a signal.

        Parameters
        ----------
        signal : signal [keV], (row, column)
        seed, frame, channel, stream : key of the noise

        Returns
        -------
        reading [keV], (row, column)
        """
        random = generator(seed, _STREAM[stream], frame, channel)
        return signal + self.offset + self.sigma * random.standard_normal(signal.shape)
