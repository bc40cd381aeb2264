"""How finely a scan is computed: the numbers that trade time for accuracy, in one place.

`phantomgen.planning` finds the cheapest settings that meet a tolerance; the defaults are finer than most scans need.
"""

from dataclasses import asdict, dataclass
from typing import Any

from phantomgen.ops.expose import RAYS_PER_VOXEL, RULES


@dataclass(frozen=True)
class Settings:
    """Discretisation of a simulation.

    Parameters
    ----------
    rules : Gauss nodes across and along the silhouettes in a pixel, for growing contrast
    sub_rays : if given, a plain grid of so many rays along each edge of a pixel in place of these
    rays_per_voxel : along each side of a pixel, for each voxel of a map that the side is long
    """

    rules: tuple[tuple[int, int], ...] = RULES
    sub_rays: int | None = None
    rays_per_voxel: float = RAYS_PER_VOXEL

    @property
    def pixels(self) -> dict[str, Any]:
        """Those that `phantomgen.ops.expose.expose` takes."""
        return {"rules": self.rules, "sub_rays": self.sub_rays, "rays_per_voxel": self.rays_per_voxel}

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)
