"""The distances between Gaussians at which about as many are placed as are wanted."""

import math
from collections.abc import Callable, Sized
from typing import TypeVar

Places = TypeVar("Places", bound=Sized)

TRIES = 12  # placements, at most; three or four come close where the number falls evenly
CLOSE = 0.01  # part of the wanted number; a placement this close is taken
POWER = 2.5  # by which the number falls with the distance: 2 on surfaces, 3 inside; for the first step
LEAST_POWER = 0.5  # bounds the steps where voxels are too few for more Gaussians


def places_for(count: int, place: Callable[[float], Places]) -> tuple[float, Places]:
    """Place about as many Gaussians as are wanted, by secants and bisection in logarithms.

    Parameters
    ----------
    count : number of Gaussians; 0 for those at the distances as they are
    place : makes the places for a factor of all distances

    Returns
    -------
    the factor, and the places whose number is closest to the wanted one
    """
    best = 1.0, place(1.0)
    factor, found, power = 1.0, max(len(best[1]), 1), POWER
    low, high = 0.0, math.inf  # factors with too many, and with too few places
    for _ in range(TRIES - 1 if count else 0):
        if abs(found - count) <= CLOSE * count:
            break
        low, high = (factor, high) if found > count else (low, factor)
        step = factor * (found / count) ** (1 / power)
        following = step if low < step < high else math.sqrt(low * high)
        places = place(following)
        if abs(len(places) - count) < abs(len(best[1]) - count):
            best = following, places
        power = max(math.log(found / max(len(places), 1)) / math.log(following / factor), LEAST_POWER)
        factor, found = following, max(len(places), 1)
    return best
