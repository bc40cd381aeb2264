"""Dose of a scan in numbers: air kerma, CTDI, and the dose of each material."""

from dataclasses import dataclass
from typing import Any

from phantomgen.analysis.air_kerma import kerma_at_isocentre
from phantomgen.dose.ctdi import BODY, HEAD, Ctdi, ctdi_of
from phantomgen.dose.dose_map import DoseMap, dose_map
from phantomgen.scene.scan import Scan
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class DoseReport:
    """Dose of a scan.

    Parameters
    ----------
    name : of the scene
    views : of all splits
    kerma : air kerma at the isocentre with nothing in the beam [Gy]
    ctdi : in the head and in the body cylinder; none where it is not defined
    map : dose in voxels; None where it cannot be computed
    missing : sentences on what is missing
    """

    name: str
    views: int
    kerma: float
    ctdi: tuple[Ctdi, ...]
    map: DoseMap | None
    missing: tuple[str, ...]

    @classmethod
    def of(
        cls, scan: Scan, photons: int, voxels: int, seed: int = 0, map_needed: bool = False, progress: bool = False
    ) -> "DoseReport":
        """Compute the dose of a scan.

        Parameters
        ----------
        scan : the scan
        photons : that are followed, for each cylinder and for the map
        voxels : of the map, along the longest edge of the volume
        seed : of their random numbers
        map_needed : refuse a scan without a map, before anything is computed
        progress : show bars on stderr

        Returns
        -------
        the numbers

        Raises
        ------
        InputError
            When the scan has several sources, its sample moves, or a map is needed and cannot be computed.
        """
        missing: list[str] = []
        found = None
        try:
            found = dose_map(scan, photons, voxels, seed, "dose map" if progress else None)
        except InputError as error:
            if map_needed:
                raise
            missing.append(str(error))
        ctdi: tuple[Ctdi, ...] = ()
        try:
            ctdi = tuple(
                ctdi_of(scan, diameter, photons, seed, f"CTDI, {diameter / 10:g} cm" if progress else None)
                for diameter in (HEAD, BODY)
            )
        except InputError as error:
            missing.append(str(error))
        if found is None and not ctdi:
            raise InputError(missing[0])
        return cls(scan.name, len(scan.geometry), kerma_at_isocentre(scan), ctdi, found, tuple(missing))

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON.

        Returns
        -------
        the mapping; no map but its means
        """
        found = self.map
        return {
            "name": self.name,
            "views": self.views,
            "air_kerma_Gy_at_isocentre": self.kerma,
            "ctdi": [each.to_dict() for each in self.ctdi],
            "dose": None
            if found is None
            else {
                "materials": {
                    name: {"mean_Gy": dose, "mass_kg": mass} for name, (dose, mass) in found.materials.items()
                },
                "largest_Gy": float(found.dose.max()),
                "imparted_J": found.energy,
                "absorbed_part": found.absorbed,
                "relative_error_of_a_voxel": found.typical_error,
            },
            "missing": list(self.missing),
        }

    @property
    def text(self) -> str:
        """Lines for people."""
        lines = [
            f"{self.name}: {self.views} views",
            f"air kerma    {_milligray(self.kerma)} at the isocentre, with nothing in the beam",
        ]
        for each in self.ctdi:
            turn = "" if each.pitch == 1 else f", pitch {each.pitch:.3g}"
            lines.append(
                f"CTDIvol      {_milligray(each.volume)} in {each.diameter / 10:g} cm of PMMA "
                f"(centre {_milligray(each.centre)}, periphery {_milligray(each.periphery)}{turn}, "
                f"+- {100 * each.error:.1f} %)"
            )
        if self.ctdi:
            lines.append(f"beam         {self.ctdi[0].width:.1f} mm wide at the isocentre")
        if self.map is not None:
            means = ", ".join(f"{name} {_milligray(dose)}" for name, (dose, _) in self.map.materials.items())
            lines += [
                f"dose         {means}",
                f"             {1e3 * self.map.energy:.3g} mJ imparted, {100 * self.map.absorbed:.1f} % of the energy "
                f"of all photons; +- {100 * self.map.typical_error:.1f} % in a typical voxel",
            ]
        return "\n".join([*lines, *(f"missing      {sentence}" for sentence in self.missing)])


def _milligray(dose: float) -> str:
    return f"{1e3 * dose:.4g} mGy"
