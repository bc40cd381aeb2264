"""Plan of a simulation: the settings chosen and the shares of the tolerance."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.exposure import Exposure
from spectra.errors import InputError

# Worst error of log projections, no unit, that is wanted by default: the noise of 1e6 photons.
TOLERANCE = 1e-3
# Limits of a tolerance, no unit.
_LEAST, _MOST = 1e-9, 1.0
# Shares of the tolerance; the average over pixels gets what is left, so that they sum to 1, as errors may add up.
ENERGY, _TESSELLATION, _SPOT = 0.25, 0.25, 0.4
# Share of bins in that of energies.
BINS = 0.3


@dataclass(frozen=True)
class Trial:
    """Setting that was tried.

    Parameters
    ----------
    setting : name of the setting
    error : its worst error of log counts
    cost : rays per pixel, or nodes
    """

    setting: str
    error: float
    cost: float


@dataclass(frozen=True)
class Choice:
    """The cheapest setting of a part that meets its share of the tolerance, or the finest one.

    Parameters
    ----------
    part : of the simulation
    setting : what was chosen
    error : worst error of log counts against a much finer computation
    share : of the tolerance
    trials : settings that were tried, the cheapest first
    of_pixels : whether it is about one kind of pixels; errors of such parts never meet
    decided : the faint object that made it finer than the share requires; empty where the share decided
    """

    part: str
    setting: str
    error: float
    share: float
    trials: tuple[Trial, ...] = ()
    of_pixels: bool = False
    decided: str = ""

    @property
    def met(self) -> bool:
        """True when the error is not larger than the share."""
        return self.error <= self.share

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Choice":
        """Create a choice from what `to_dict` returns.

        Parameters
        ----------
        values : the mapping

        Returns
        -------
        the choice
        """
        return cls(**{**values, "trials": tuple(Trial(**trial) for trial in values["trials"])})


@dataclass(frozen=True, eq=False)
class Plan:
    """Plan of a simulation: its settings and the error of each part.

    Parameters
    ----------
    tolerance : of log projections
    scan : what is simulated, with as fine triangles as its smooth surfaces need
    settings : the cheapest ones that meet it, part by part
    exposure : energies with the nodes that were chosen
    choices : what was chosen for each part, and the error that was measured
    """

    tolerance: float
    scan: Scan
    settings: Settings
    exposure: Exposure
    choices: tuple[Choice, ...]

    @property
    def error(self) -> float:
        """Error of all parts together: errors may add up, but a pixel is of one kind only."""
        others = sum(choice.error for choice in self.choices if not choice.of_pixels)
        return others + max((choice.error for choice in self.choices if choice.of_pixels), default=0.0)

    @property
    def nodes(self) -> tuple[int, ...]:
        """Energy nodes per channel."""
        return tuple(b - a for a, b in pairwise(self.exposure.transmission.starts.tolist()))

    @property
    def missed(self) -> tuple[Choice, ...]:
        """Parts that cannot meet their share, where the whole misses the tolerance."""
        return () if self.error <= self.tolerance else tuple(c for c in self.choices if not c.met)

    def check(self) -> None:
        """Refuse a tolerance that is missed.

        Raises
        ------
        InputError
            With the parts that miss it, and what they reach.
        """
        if self.missed:
            reached = float(f"{1.05 * self.error:.1e}")
            raise InputError(f"--tol {self.tolerance:g} cannot be met: {self._reached}; {reached:g} can")

    @property
    def warnings(self) -> list[str]:
        """A sentence where the tolerance is missed."""
        return [f"the tolerance {self.tolerance:g} is missed: {self._reached}"] if self.missed else []

    @property
    def _reached(self) -> str:
        """Text with the errors of the parts that miss their share."""
        return ", ".join(f"{c.part} reach {c.error:.1e} with {c.setting}" for c in self.missed)

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return {
            "tolerance": self.tolerance,
            "error": self.error,
            "settings": self.settings.to_dict(),
            "nodes": list(self.nodes),
            "parts": [choice.to_dict() for choice in self.choices],
        }

    @property
    def text(self) -> str:
        """Plan as text, one line per part."""
        width = max(len(c.part) for c in self.choices)
        lines = [
            f"{c.part:<{width}}  {c.error:.1e}  {c.setting}"
            + (f"; its share is {c.share:.1e}" if c in self.missed else "")
            + (f", for {c.decided}" if c.decided else "")
            for c in self.choices
        ]
        verdict = "meets" if self.error <= self.tolerance else "MISSES"
        digits = 1 if f"{self.error:.1e}" != f"{self.tolerance:.1e}" or verdict == "meets" else 3  # that show the miss
        return "\n".join([*lines, f"{'together':<{width}}  {self.error:.{digits}e}  {verdict} {self.tolerance:.0e}"])


def check_tolerance(tolerance: float) -> None:
    """Refuse a tolerance that is no number between 1e-9 and 1.

    Parameters
    ----------
    tolerance : worst error of log projections

    Raises
    ------
    InputError
        When it is outside these limits.
    """
    if not _LEAST <= tolerance <= _MOST:
        raise InputError(f"--tol must lie in {_LEAST:g} .. {_MOST:g}, an error of log projections, got {tolerance:g}")
