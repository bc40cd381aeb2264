"""The distances between Gaussians at which about as many are placed as are wanted."""

import math
from collections.abc import Callable, Sized
from typing import TypeVar

Places = TypeVar("Places", bound=Sized)

TRIES = 8  # placements, at most; three or four come close
CLOSE = 0.01  # part of the wanted number; a placement this close is taken
POWER = 2.5  # by which the number falls with the distance: 2 on surfaces, 3 inside; for the first step
LEAST_POWER = 0.5  # bounds the steps where voxels are too few for more Gaussians


def places_for(count: int, place: Callable[[float], Places]) -> tuple[float, Places]:
    """Place about as many Gaussians as are wanted, by the secant method in logarithms.

    Parameters
    ----------
    count : number of Gaussians; 0 for those at the distances as they are
    place : makes the places for a factor of all distances

    Returns
    -------
    the factor, and the places whose number is closest to the wanted one
    """
    factor, power = 1.0, POWER
    best = factor, place(factor)
    if not count:
        return best
    found = max(len(best[1]), 1)
    for _ in range(TRIES - 1):
        if abs(len(best[1]) - count) <= CLOSE * count:
            break
        step = (found / count) ** (1 / power)
        places = place(factor * step)
        if abs(len(places) - count) < abs(len(best[1]) - count):
            best = factor * step, places
        power = max(math.log(found / max(len(places), 1)) / math.log(step), LEAST_POWER)
        factor, found = factor * step, max(len(places), 1)
    return best
