"""Average over one pixel by its definition, one ray after the other."""

import numpy as np
from jaxtyping import Float

from phantomgen.ops.expected_counts.inputs import Spectrum
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace.reference import trace_one


def expected_counts_of_pixel(
    frame: Float[np.ndarray, "4 3"],
    pixel: tuple[int, int],
    solids: Solids,
    spectrum: Spectrum,
    n: int,
    background: int = -1,
) -> Float[np.ndarray, " channel"]:
    """Compute the expected counts of a pixel, the mean over n x n rays of ``sum_k w_k exp(-sum_m mu_mk L_m)``.

    Parameters
    ----------
    frame : as in `phantomgen.ops.expected_counts.expected_counts` [mm]
    pixel : row and column
    solids, spectrum : as there
    n : rays along each edge of the pixel
    background : material outside all shapes, -1 for none

    Returns
    -------
    counts, (channel,)
    """
    source, corner, column_step, row_step = frame
    offsets = (np.arange(n) + 0.5) / n - 0.5
    counts, attenuation = np.zeros(spectrum.channels), spectrum.attenuation
    for v in pixel[0] + offsets:
        for u in pixel[1] + offsets:
            lengths = trace_one(source, corner + u * column_step + v * row_step, solids, len(attenuation), background)
            counts += np.add.reduceat(spectrum.weights * np.exp(-lengths @ attenuation), spectrum.starts[:-1])
    return counts / n**2
