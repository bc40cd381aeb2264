"""Random sequential addition by comparing every pair."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int


def place_one_by_one(
    radii: Float[np.ndarray, " ball"],
    candidates: Callable[[int, Int[np.ndarray, " some"]], Float[np.ndarray, "some 3"]],
    gap: float,
    rounds: int,
    groups: int,
) -> dict[int, Float[np.ndarray, " 3"]]:
    """Place balls within some rounds, the groups of larger ones first.

    Parameters
    ----------
    radii, candidates, gap : as in `phantomgen.ops.place_balls.place_balls`
    rounds, groups : number of rounds, and of groups

    Returns
    -------
    centres [mm] of the balls that find a place, by their numbers
    """
    found: dict[int, np.ndarray] = {}
    for group in np.array_split(np.argsort(-radii, kind="stable"), groups):
        for attempt in range(rounds):
            points = candidates(attempt, np.arange(len(radii)))
            for b in group.tolist():
                if b not in found and all(
                    np.linalg.norm(points[b] - center) >= radii[a] + radii[b] + gap for a, center in found.items()
                ):
                    found[b] = points[b]
    return found
