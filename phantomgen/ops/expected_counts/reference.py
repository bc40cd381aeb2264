"""The average over one pixel as its definition says, one ray after the other."""

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.ops.solids import Solids
from phantomgen.ops.trace.reference import trace_one


def expose_one(
    frame: Float[np.ndarray, "4 3"],
    pixel: tuple[int, int],
    solids: Solids,
    attenuation: Float[np.ndarray, "material node"],
    weights: Float[np.ndarray, " node"],
    starts: Int64[np.ndarray, " boundary"],
    n: int,
    background: int = -1,
) -> Float[np.ndarray, " channel"]:
    """Expected counts of the pixel (row, column): mean over n x n rays of ``sum_k w_k exp(-sum_m mu_mk L_m)``."""
    source, corner, column_step, row_step = frame
    offsets = (np.arange(n) + 0.5) / n - 0.5
    counts = np.zeros(len(starts) - 1)
    for v in pixel[0] + offsets:
        for u in pixel[1] + offsets:
            lengths = trace_one(source, corner + u * column_step + v * row_step, solids, len(attenuation), background)
            counts += np.add.reduceat(weights * np.exp(-lengths @ attenuation), starts[:-1])
    return counts / n**2
