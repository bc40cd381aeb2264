"""Search for the place of the panel: where the views contradict each other least, and how sure this is."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from recon.alignment.misfit import misfit, misfit_of_opposite_turns
from recon.alignment.projections import Projections, read_projections
from spectra.errors import InputError

# All chosen on scans of `kedge-small` (tests/recon/alignment), for errors below 0.05 pixel in about a minute.
_COARSE = (60, 48, 32)  # views, columns, voxels of the scan over all shifts
_FINE = (90, 96, 64)  # the same of the last steps
_STEPS = (1.0, 0.5, 0.25)  # of the fine search, in pixels of its views
_PARTS = 4  # parts of the views, each with its own answer, whose spread is the uncertainty
_LEAST_ROWS = 8  # on fewer rows a turn of the panel is not seen
_FAR = 3.0  # steps; the minimum of a parabola is not followed further than this


@dataclass(frozen=True)
class Alignment:
    """Where the panel was, against where the file states it.

    Parameters
    ----------
    shift, shift_error : of the panel along its columns, and one standard deviation [pixel of the file]
    turn, turn_error : of the panel in its plane, from columns towards rows, and one standard deviation [degree]; both 0
        where it was not searched for
    misfit_before, misfit_after : part of the views that no volume explains, with the poses of the file and with those
        that were found
    misfit_of_opposite_turns : the same where the sample turned the other way round; None where views have no angles
    """

    shift: float
    shift_error: float
    turn: float
    turn_error: float
    misfit_before: float
    misfit_after: float
    misfit_of_opposite_turns: float | None

    @property
    def turns_the_other_way(self) -> bool:
        """True where views fit better to a sample that turned the other way round."""
        return self.misfit_of_opposite_turns is not None and self.misfit_of_opposite_turns < self.misfit_after


def align(
    dataset: Dataset, largest_shift: float = 12.0, tilt: bool = True, on_step: Callable[[], object] = lambda: None
) -> Alignment:
    """Find the shift of the panel along its columns, and its turn in its plane, from the views.

    A wrong shift is the same as a wrong centre of rotation, and a turn the same as an axis that leans sidewards.

    Parameters
    ----------
    dataset : open dataset
    largest_shift : largest shift that is looked for [pixel]
    tilt : whether the turn is looked for
    on_step : called after each evaluation of the misfit

    Returns
    -------
    what was found

    Raises
    ------
    InputError
        When there are too few views, or the largest shift is no positive number.
    """
    if not 0 < largest_shift < np.inf:
        raise InputError(f"the largest shift must be a positive number of pixels, got {largest_shift:g}")
    if len(dataset.splits["train"]) < 2 * _PARTS:
        raise InputError(
            f"{dataset.path} has {len(dataset.splits['train'])} training views: finding the panel needs {2 * _PARTS}"
        )
    pitch = dataset.geometry.panel.column_pitch
    coarse, fine = read_projections(dataset, *_COARSE), read_projections(dataset, *_FINE)
    wide, narrow = (data.geometry.panel.column_pitch / pitch for data in (coarse, fine))

    def at(data: Projections, shift: float, turn: float) -> float:
        value = misfit(data, shift, turn)
        on_step()
        return value

    steps = np.arange(-np.ceil(largest_shift / wide), np.ceil(largest_shift / wide) + 1)
    shift = float(steps[np.argmin([at(coarse, step, 0.0) for step in steps])]) * wide / narrow
    edge = np.rad2deg(2 / fine.geometry.panel.rows)  # turn that moves the border of the panel by a pixel
    tilt = tilt and fine.geometry.panel.rows >= _LEAST_ROWS
    found = np.array([shift, 0.0])
    for step in _STEPS:
        found = _lowest(lambda s, t: at(fine, s, t), found, (step, step * edge if tilt else 0.0))
    last = (_STEPS[-1], _STEPS[-1] * edge if tilt else 0.0)
    each = [_lowest(lambda s, t, i=i: at(fine[i::_PARTS], s, t), found, last) for i in range(_PARTS)]
    shift_error, turn_error = np.std(each, axis=0, ddof=1) / np.sqrt(_PARTS)
    other = misfit_of_opposite_turns(fine, *found) if np.isfinite(fine.geometry.angles).all() else None
    return Alignment(
        shift=float(found[0] * narrow),
        shift_error=float(shift_error * narrow),
        turn=float(found[1]),
        turn_error=float(turn_error),
        misfit_before=at(fine, 0.0, 0.0),
        misfit_after=at(fine, *found),
        misfit_of_opposite_turns=other,
    )


def _lowest(
    function: Callable[[float, float], float], start: Float[np.ndarray, "2"], steps: tuple[float, float]
) -> Float[np.ndarray, "2"]:
    """Minimum of the parabola through values around `start`; a variable whose step is 0 stays.

    A minimum beyond three steps is not believed: the parabola is made again around the end of three steps.
    """
    place = start
    for _ in range(4):
        move = _parabola(function, place, steps)
        inside = np.clip(move, -_FAR, _FAR)
        place = place + inside * steps
        if (np.abs(move) <= 1.0).all():
            break
    return place


def _parabola(
    function: Callable[[float, float], float], start: Float[np.ndarray, "2"], steps: tuple[float, float]
) -> Float[np.ndarray, "2"]:
    """Way from `start` to the minimum of a parabola through six points (three for one variable), in steps."""
    free = [i for i, step in enumerate(steps) if step > 0]
    unit = np.eye(2)[free]

    def at(*moves: Float[np.ndarray, "2"]) -> float:
        return function(*(start + np.sum(moves, axis=0) * steps))

    middle = at(np.zeros(2))
    above, below = np.array([at(e) for e in unit]), np.array([at(-e) for e in unit])
    slope, bends = (above - below) / 2, np.diag(above + below - 2 * middle)
    for i, j in pairwise(range(len(free))):
        bends[i, j] = bends[j, i] = at(unit[i], unit[j]) - above[i] - above[j] + middle
    lowest = np.linalg.eigvalsh(bends)[0]
    if lowest <= 0:  # no valley here: go downhill by whole steps
        move = -np.sign(slope) * _FAR
    else:
        move = -np.linalg.solve(bends, slope)
    out = np.zeros(2)
    out[free] = move
    return out
