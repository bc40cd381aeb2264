"""What a hard case is: difficulties, what is computed there, and what would be right."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from spectra.errors import InputError, shortened


@dataclass(frozen=True)
class Point:
    """One computation.

    Parameters
    ----------
    difficulty : on the axis that the case names
    found, expected : what is computed, and the closed form
    error : what is judged, in the unit that the case names
    """

    difficulty: float
    found: float
    expected: float
    error: float


@dataclass(frozen=True)
class Case:
    """A trap, and how far results may be from the closed form.

    Parameters
    ----------
    name : on the command line
    what : what is hard
    difficulty : name and unit of the axis of difficulty
    error : what the error is, and its unit
    limit : largest error that passes
    points : computes the points, from easy to hard
    """

    name: str
    what: str
    difficulty: str
    error: str
    limit: float
    points: Callable[[], Iterator[Point]]

    def run(self) -> "Outcome":
        """Compute all points.

        Returns
        -------
        the outcome
        """
        return Outcome(self, tuple(self.points()))


@dataclass(frozen=True)
class Outcome:
    """Points of a case.

    Parameters
    ----------
    case : the case
    points : from easy to hard
    """

    case: Case
    points: tuple[Point, ...]

    @property
    def worst(self) -> float:
        """Largest error; infinite where one is no number."""
        errors = np.array([point.error for point in self.points])
        return float(errors.max()) if np.isfinite(errors).all() else float("inf")

    @property
    def passed(self) -> bool:
        """Whether all errors are within the limit."""
        return self.worst <= self.case.limit

    def to_dict(self) -> dict[str, Any]:
        """Convert to plain values.

        Returns
        -------
        name, axes, limit, verdict and points
        """
        case = self.case
        return {
            "name": case.name,
            "what": case.what,
            "difficulty": case.difficulty,
            "error": case.error,
            "limit": case.limit,
            "worst": self.worst,
            "passed": self.passed,
            "points": [asdict(point) for point in self.points],
        }


def chosen_cases(cases: Sequence[Case], names: Sequence[str]) -> tuple[Case, ...]:
    """Look up cases by name.

    Parameters
    ----------
    cases : to choose from
    names : of cases; none for all

    Returns
    -------
    the cases

    Raises
    ------
    InputError
        When there is no such case.
    """
    known = {case.name: case for case in cases}
    for name in names:
        if name not in known:
            raise InputError(f"there is no case {shortened(name)!r}: choose from {', '.join(known)}")
    return tuple(known[name] for name in names) or tuple(cases)
