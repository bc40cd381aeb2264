"""Balls at random places, none of which touch: random sequential addition, the largest first."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Int

# Rounds in which no ball finds a place; after so many, no place is taken to be left.
PATIENCE = 300
# Groups of similar size that are placed one after the other, as large balls find no room among many small ones.
GROUPS = 16


def place_balls(
    radii: Float[np.ndarray, " ball"],
    candidates: Callable[[int, Int[np.ndarray, " some"]], Float[np.ndarray, "some 3"]],
    gap: float,
) -> tuple[Float[np.ndarray, "ball 3"], int]:
    """Place balls at random with at least a gap between any two.

    In each round every ball of a group that has no place yet tries its next candidate. Balls are sought in the cells of
    a grid as wide as the largest ball with its gap, so that only 27 cells can hold one that is near.

    Parameters
    ----------
    radii : of the balls [mm]
    candidates : centres that some of the balls try in a round [mm]
    gap : least distance of two surfaces [mm]

    Returns
    -------
    centres [mm], and the number of balls that found a place
    """
    from phantomgen.ops.place_balls.cpu import BallCells, fill_round  # noqa: PLC0415 - numba only where it computes

    width = 2 * float(radii.max(initial=0)) + gap or 1.0
    centers, following = np.zeros((len(radii), 3)), np.full(len(radii), -1)
    cells = BallCells(width, np.full(1 << max(4, int(2 * len(radii)).bit_length()), -1), following)
    placed = np.zeros(len(radii), np.bool_)
    for group in np.array_split(np.argsort(-radii, kind="stable"), GROUPS):
        waiting, attempt, last = group, 0, 0
        while len(waiting) and attempt - last <= PATIENCE:
            fill_round(candidates(attempt, waiting), radii, gap, waiting, cells, centers, placed)
            left = waiting[~placed[waiting]]
            last = attempt if len(left) < len(waiting) else last
            waiting, attempt = left, attempt + 1
        if len(waiting):
            break
    return centers, int(placed.sum())
