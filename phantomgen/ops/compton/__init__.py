"""Signal of photons that free electrons scatter once (Klein & Nishina 1929, doi:10.1007/BF01366453).

Of N photons per solid angle that leave the source, those that a point with n electrons at the distance d scatters by
the angle theta into a pixel that it sees under the solid angle Omega measure

    N / d^2  exp(-way in)  n  d sigma / d Omega  Omega  exp(-way out)  signal(k E)
    k = 1 / (1 + E / mc^2 (1 - cos theta))
    d sigma / d Omega = r_e^2 / 2  k^2 (k + 1/k - sin^2 theta)

and energy bins keep their photons evenly spread when k makes them narrower.
"""

import numpy as np
from jaxtyping import Float

from phantomgen.ops.compton.inputs import Energies, Points


def scattered_to(
    pixel: Float[np.ndarray, " 3"],
    area: Float[np.ndarray, " 3"],
    source: Float[np.ndarray, " 3"],
    points: Points,
    lengths: Float[np.ndarray, "point material"],
    energies: Energies,
) -> Float[np.ndarray, " group"]:
    """Compute the signal that all points scatter to a pixel.

    Parameters
    ----------
    pixel, area : centre of the pixel [mm], and its normal, as long as its sensitive area [mm^2]
    source : where photons come from [mm]
    points : where they are scattered
    lengths : path lengths in each material from each point to the pixel [mm]
    energies : of photons

    Returns
    -------
    signal of each group
    """
    from phantomgen.ops.compton.cpu import add_scattered  # noqa: PLC0415 - numba only where it computes

    out = np.zeros(energies.measured.shape[1])
    add_scattered(pixel, area, source, points, lengths, energies, out)
    return out
