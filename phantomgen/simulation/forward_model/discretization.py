"""How finely a scan is computed: the numbers that trade time for accuracy, in one place.

`phantomgen.simulation.planning.make_plan` finds the cheapest settings that meet a tolerance; the defaults are finer
than most scans need.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from phantomgen.ops.expected_counts import INTERSECTION_TOLERANCE, RAYS_PER_VOXEL, RULES, Sampling

# Gauss nodes across and along the silhouettes in a pixel, for growing contrast, from cheap to fine.
RULE_LADDER = (
    ((1, 1), (2, 1), (2, 2), (3, 2), (4, 3)),
    ((2, 1), (2, 2), (3, 2), (4, 3), (6, 4)),
    RULES,
    ((3, 2), (4, 3), (6, 4), (9, 6), (12, 8)),
    ((4, 3), (6, 4), (9, 6), (12, 8), (18, 12)),
    ((8, 6), (10, 8), (14, 10), (18, 12), (24, 16)),
    ((12, 9), (15, 12), (20, 14), (25, 17), (32, 22)),
    ((18, 14), (22, 18), (28, 20), (34, 24), (42, 30)),
    ((26, 20), (30, 25), (38, 28), (46, 33), (56, 40)),
)


@dataclass(frozen=True)
class Settings:
    """Discretisation of a simulation.

    Parameters
    ----------
    rules : Gauss nodes across and along the silhouettes in a pixel, for growing contrast
    intersections : error of log counts that is left in pixels where surfaces intersect or edges of a mesh pass
    sub_rays : if given, a plain grid of so many rays along each edge of a pixel in place of these
    rays_per_voxel : along each side of a pixel, for each voxel of a map that the side is long
    spot : source points of a focal spot of finite size, up to 985; by default as many as its blur requires
    scatter : of Compton scatter, cells along each edge of the volume, and places along each edge of the panel
    """

    rules: tuple[tuple[int, int], ...] = RULES
    intersections: float = INTERSECTION_TOLERANCE
    sub_rays: int | None = None
    rays_per_voxel: float = RAYS_PER_VOXEL
    spot: int | None = None
    scatter: tuple[int, int] = (12, 5)

    def sampling(self, aperture: tuple[float, float]) -> Sampling:
        """Return the rules for the average over a pixel.

        Parameters
        ----------
        aperture : width and height of the sensitive part of a pixel [pixel]

        Returns
        -------
        the rules
        """
        return Sampling(
            rules=self.rules,
            sub_rays=self.sub_rays,
            intersection_tolerance=self.intersections,
            rays_per_voxel=self.rays_per_voxel,
            aperture=aperture,
        )

    def to_dict(self) -> dict[str, Any]:
        """Return all settings under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Settings":
        """Create settings from what `to_dict` returned, also after JSON.

        In older datasets `intersections` is called ``kinks``.

        Parameters
        ----------
        values : the mapping

        Returns
        -------
        the settings
        """
        known = {"intersections" if name == "kinks" else name: value for name, value in values.items()}
        rules, scatter = tuple(map(tuple, known["rules"])), tuple(known["scatter"])
        return cls(**{**known, "rules": rules, "scatter": scatter})
