"""How finely a scan is computed: the numbers that trade time for accuracy, in one place.

`phantomgen.planning` finds the cheapest settings that meet a tolerance; the defaults are finer than most scans need.
"""

from dataclasses import asdict, dataclass
from typing import Any

from phantomgen.ops.expose import RULES


@dataclass(frozen=True)
class Settings:
    """Discretisation of a simulation.

    Parameters
    ----------
    energy : worst error of log counts that few energy nodes in place of many bins may add
    rules : Gauss nodes across and along the silhouettes in a pixel, for growing contrast
    sub_rays : if given, a plain grid of so many rays along each edge of a pixel in place of these
    """

    energy: float = 1e-5
    rules: tuple[tuple[int, int], ...] = RULES
    sub_rays: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)
