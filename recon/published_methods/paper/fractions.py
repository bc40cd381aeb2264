"""First material fractions from density: dense means photoelectric, very dense means K edge."""

import numpy as np
from jaxtyping import Float
from scipy.special import expit

MOST_EDGE = 0.5  # f_K,max
UNGATED = 0.2  # of it where there is no gate
ODDS = float(np.log(9.0))  # a sigmoid goes from one half to nine tenths between the two quantiles that set its slope
MIDDLE, HIGH = 0.5, 0.9  # quantiles of density that set rho_0 and the slope a
DENSE, DENSEST = 0.95, 0.99  # quantiles that set rho_K and the slope a_K
LEAST_SPREAD = 1e-3  # between quantiles, relative; objects of one density give nearly a step


def fractions_of_density(
    density: Float[np.ndarray, " gaussian"], bases: int, by_density: bool = True, gate: bool = True
) -> Float[np.ndarray, "gaussian basis"]:
    """f_PE = s(a (log rho - log rho_0)) and f_C = 1 - f_PE; a gate moves part of f_PE to the K edge.

    With g = s(a_K (rho / rho_K - 1)) the K edge gets f_K = f_max g f_PE, and photoelectric keeps the rest. The paper
    takes rho_0, rho_K and both slopes from quantiles that it does not state.

    Parameters
    ----------
    density : positive, in any unit
    bases : 2 or 3
    by_density : whether fractions depend on density; they are equal otherwise
    gate : whether the K edge's part of f_PE depends on density
    """
    if not by_density:
        return np.full((len(density), bases), 1 / bases)
    middle, high, dense, densest = np.quantile(density, [MIDDLE, HIGH, DENSE, DENSEST])
    slope = ODDS / max(np.log(high / middle), LEAST_SPREAD)
    photoelectric = expit(slope * np.log(density / middle))
    if bases == 2:
        return np.stack([photoelectric, 1 - photoelectric], axis=1)
    steepness = ODDS / max(densest / dense - 1, LEAST_SPREAD)
    opening = expit(steepness * (density / dense - 1)) if gate else UNGATED
    edge = MOST_EDGE * opening * photoelectric
    return np.stack([photoelectric - edge, 1 - photoelectric, edge], axis=1)
