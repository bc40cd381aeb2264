"""From line integrals to expected counts: Y_c = sum_k w_ck exp(-sum_m B_m(E_k) L_m).

The numpy functions take rays in rows and split them over threads; `transmit` is the same for torch tensors, with the
gradient. Inside another numba kernel call `expected_ray`.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int64

from spectra.ops.transmit import cpu
from spectra.ops.transmit.cpu import expected_ray
from spectra.threads import run_parallel

__all__ = ["expected_and_jacobian", "expected_counts", "expected_ray", "log_counts_and_slopes"]

# Rays per piece of work of a thread; changes time, not results.
_RAYS_PER_PIECE = 16384
Lengths = Float[np.ndarray, "ray basis"]
Columns = Float[np.ndarray, "basis node"]
Weights = Float[np.ndarray, " node"]
Starts = Int64[np.ndarray, " channel_plus_1"]
Counts = Float[np.ndarray, "ray channel"]
CountsPerLength = Float[np.ndarray, "ray channel basis"]


def expected_counts(lengths: Lengths, columns: Columns, weights: Weights, starts: Starts) -> Counts:
    """Compute expected counts per channel; a ray through too much material gives 0.

    Parameters
    ----------
    lengths : line integrals, (ray, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``

    Returns
    -------
    counts, (ray, C)
    """
    out = np.empty((len(lengths), len(starts) - 1))
    _over_rays(cpu.expected_counts, lengths, columns, weights, starts, out)
    return out


def expected_and_jacobian(
    lengths: Lengths, columns: Columns, weights: Weights, starts: Starts
) -> tuple[Counts, CountsPerLength]:
    """Compute expected counts and their derivatives dY_c/dL_m.

    Parameters
    ----------
    lengths : line integrals, (ray, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``

    Returns
    -------
    counts, (ray, C), and derivatives, (ray, C, M) [counts/mm for lengths in mm]
    """
    out = np.empty((len(lengths), len(starts) - 1))
    jacobian = np.empty((*out.shape, len(columns)))
    _over_rays(cpu.expected_and_jacobian, lengths, columns, weights, starts, out, jacobian)
    return out, jacobian


def log_counts_and_slopes(
    lengths: Lengths, columns: Columns, weights: Weights, starts: Starts
) -> tuple[Counts, CountsPerLength]:
    """Compute the log of the expected counts and -d(log Y_c)/dL_m; finite for any length of the path.

    A channel without nodes has log counts of -inf and slope 0.

    Parameters
    ----------
    lengths : line integrals, (ray, M)
    columns : functions of energy at the nodes, (M, K)
    weights : photons x response of each node
    starts : channel c owns the nodes ``starts[c]`` to ``starts[c + 1]``

    Returns
    -------
    log counts, (ray, C), and slopes, (ray, C, M)
    """
    out = np.empty((len(lengths), len(starts) - 1))
    slopes = np.empty((*out.shape, len(columns)))
    _over_rays(cpu.log_counts_and_slopes, lengths, columns, weights, starts, out, slopes)
    return out, slopes


def _over_rays(kernel: Callable, lengths: Lengths, columns: Columns, weights: Weights, starts: Starts, *out) -> None:
    """Run `kernel` on pieces of the rays; each piece writes its own rows, so threads do not change the result."""
    lengths = np.ascontiguousarray(lengths, dtype=np.float64)

    def piece(first: int) -> None:
        rows = slice(first, first + _RAYS_PER_PIECE)
        kernel(lengths[rows], columns, weights, starts, *(array[rows] for array in out))

    firsts = range(0, len(lengths), _RAYS_PER_PIECE)
    if len(firsts) == 1:
        piece(0)
        return
    for _ in run_parallel(piece, firsts):
        pass
