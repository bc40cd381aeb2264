"""Energies of a scan in numbers: beam quality, counts per channel, conditioning, and the least noise."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.analysis.air_kerma import kerma_at_isocentre, kerma_per_view
from phantomgen.analysis.single_ray import BEHIND, SingleRayBound, layers_of, scan_photons
from phantomgen.scene.scan import Scan
from spectra.basis.basis import BasisFunction, pretty
from spectra.basis.conditioning import conditioning_of
from spectra.detector.detector import AnyDetector
from spectra.detector.multi_source import MultiSource
from spectra.elements.attenuation import mass_attenuation
from spectra.errors import InputError
from spectra.source.beam_quality import COPPER, BeamQuality, half_value_layers


@dataclass(frozen=True, eq=False)
class SpectrumReport:
    """Energies of a scan in numbers.

    Parameters
    ----------
    scan : what is described
    behind : the object that the second working point lies behind, such as ``20 cm water``
    quality : of the source, with layers of aluminium
    copper : first and second half-value layer [mm Cu]
    air, object : channels in the open beam, and behind the object
    condition : condition numbers: of the basis functions over the detected spectrum, and of the log projections in air
        and behind the object, each in the raw and in the conditioned basis
    """

    scan: Scan
    behind: str
    quality: BeamQuality
    copper: tuple[float, float]
    air: SingleRayBound
    object: SingleRayBound
    condition: dict[str, tuple[float, float]]

    @classmethod
    def of(cls, scan: Scan, behind: str = BEHIND) -> "SpectrumReport":
        """Describe the energies of a scan.

        Parameters
        ----------
        scan : the scan
        behind : layers before the second working point

        Returns
        -------
        the description
        """
        air, behind_object = SingleRayBound.of(scan), SingleRayBound.of(scan, layers_of(behind, scan))
        quality, copper = BeamQuality.of(scan.source), half_value_layers(scan.source, COPPER)
        return cls(scan, behind, quality, copper, air, behind_object, _conditions(scan, air, behind_object))

    @property
    def kerma(self) -> float:
        """Air kerma per view at the panel centre with nothing in the beam [Gy]."""
        return kerma_per_view(self.scan, self.quality.kerma_per_fluence)

    @property
    def kerma_at_isocentre(self) -> float:
        """Air kerma of the scan at the isocentre with nothing in the beam [Gy]."""
        return kerma_at_isocentre(self.scan, self.quality.kerma_per_fluence)

    @property
    def charge(self) -> float | None:
        """Charge per view [mAs] by SpekPy's model; None where the source is not a single tube."""
        found = self.scan.source_fields.get("charge")
        return None if found is None else float(found[0])

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON; what is unbounded is null.

        Returns
        -------
        the mapping
        """
        source, detector, basis = self.scan.source, self.scan.detector, self.scan.basis
        per_grams = [_per_gram(function, basis.reference_energy) for function in basis.functions]
        return {
            "name": self.scan.name,
            "photons": source.photons,
            "maximum_keV": source.maximum,
            "lines_share": float(source.line_photons.sum() / source.photons),
            "mean_energy_keV": self.quality.mean_energy,
            "effective_energy_keV": self.quality.effective_energy,
            "hvl_mm_Al": [self.quality.hvl1, self.quality.hvl2],
            "hvl_mm_Cu": list(self.copper),
            "homogeneity": self.quality.homogeneity,
            "air_kerma_Gy_per_view": self.kerma,
            "air_kerma_Gy_at_isocentre": self.kerma_at_isocentre,
            "charge_mAs_per_view": self.charge,
            "photons_per_mAs": None if self.charge is None else source.photons / self.charge,
            "behind": self.behind,
            "channels": [
                {
                    "name": channel.name,
                    "lower_keV": channel.lower,
                    "upper_keV": channel.upper,
                    "counts": float(counts),
                    "share": float(counts / source.photons),
                    "counts_per_mAs": None if self.charge is None else float(counts / self.charge),
                    "counts_behind": float(behind),
                }
                for channel, counts, behind in zip(detector.channels, self.air.counts, self.object.counts, strict=True)
            ],
            "condition": {
                name: dict(zip(("raw", "conditioned"), map(_finite, pair), strict=True))
                for name, pair in self.condition.items()
            },
            "noise": [
                {
                    "basis": name,
                    "air": _finite(air),
                    "behind": _finite(behind),
                    "behind_mg_per_cm2": None if per_gram is None else _finite(1000 * behind / per_gram),
                }
                for name, air, behind, per_gram in zip(
                    basis.names, self.air.bounds, self.object.bounds, per_grams, strict=True
                )
            ],
        }

    @property
    def text(self) -> str:
        """Description as text."""
        facts = self.to_dict()
        condition = facts["condition"]
        functions, in_air, inside = condition["functions"], condition["air"], condition["behind"]
        al, cu = facts["hvl_mm_Al"], facts["hvl_mm_Cu"]
        lines = [
            f"{facts['name']}: {facts['photons']:.4g} photons per pixel and view up to {facts['maximum_keV']:g} keV, "
            f"{facts['lines_share']:.1%} of them in lines",
            f"mean energy       {facts['mean_energy_keV']:.2f} keV",
            f"half-value layers {al[0]:.3f} and {al[1]:.3f} mm Al, {cu[0]:.4f} and {cu[1]:.4f} mm Cu of air kerma",
            f"effective energy  {facts['effective_energy_keV']:.2f} keV (Al); homogeneity {facts['homogeneity']:.3f}",
            f"air kerma         {1e6 * facts['air_kerma_Gy_per_view']:.4g} uGy per view at the panel, "
            f"{1e3 * facts['air_kerma_Gy_at_isocentre']:.4g} mGy per scan at the isocentre",
            *_charge_lines(facts["charge_mAs_per_view"], facts["photons"]),
            *_source_lines(self.scan.detector),
            "",
            *_channel_lines(facts["channels"], self.scan.detector.units, facts["behind"] or "nothing"),
            "",
            "condition numbers                       raw  conditioned",
            *(
                f"  {what:<32}{_number(pair['raw']):>9}  {_number(pair['conditioned']):>11}"
                for what, pair in (
                    ("basis functions", functions),
                    ("log projections, open beam", in_air),
                    ("log projections, behind object", inside),
                )
            ),
            "",
            "least noise of line integrals      open beam  behind object",
            *(_noise_line(noise) for noise in facts["noise"]),
        ]
        if not np.isfinite(self.object.bounds).all():
            lines.append(_hint(self.scan))
        return "\n".join(lines)


def _conditions(scan: Scan, air: SingleRayBound, behind: SingleRayBound) -> dict[str, tuple[float, float]]:
    """Condition numbers in the raw basis, and in the one that is orthonormal over the detected spectrum."""
    energies, photons = scan_photons(scan)
    detected = scan.detector.response(energies).sum(axis=0) * photons
    columns = scan.basis.evaluate(energies.nodes)
    try:
        change = conditioning_of(columns, detected).transform.T
    except InputError:  # functions that cannot be separated at all
        return dict.fromkeys(("functions", "air", "behind"), (np.inf, np.inf))

    def pair(raw: Float[np.ndarray, "row basis"]) -> tuple[float, float]:
        if len(raw) < len(scan.basis):
            return np.inf, np.inf
        return float(np.linalg.cond(raw)), float(np.linalg.cond(raw @ change))

    weighted = (columns * np.sqrt(detected / detected.sum())).T
    return {"functions": pair(weighted), "air": pair(air.slopes), "behind": pair(behind.slopes)}


def _per_gram(function: BasisFunction, reference: float) -> float | None:
    """Line integral of 1 g/cm^2 of the element of an `element` function [no unit]; None for other functions."""
    if function.kind != "element":
        return None
    energy = np.array([reference])
    own = mass_attenuation({str(function.element): 1.0}, energy)
    return float((own / function.evaluate(energy, reference))[0])


def _hint(scan: Scan) -> str:
    """Why there is no bound."""
    channels, functions = len(scan.detector), len(scan.basis)
    if channels < functions:
        return f"{channels} channels cannot tell {functions} basis functions apart: at least {functions} are needed."
    return "The channels cannot tell the basis functions apart."


def _charge_lines(charge: float | None, photons: float) -> list[str]:
    """Return the line about the tube charge."""
    return (
        []
        if charge is None
        else [f"tube charge       {charge:.4g} mAs per view, {photons / charge:.4g} photons per mAs"]
    )


def _source_lines(detector: AnyDetector) -> list[str]:
    """Each of several sources."""
    if not isinstance(detector, MultiSource):
        return []
    lines = ["of these"]
    for name, source in zip(detector.labels, detector.sources, strict=True):
        quality = BeamQuality.of(source)
        lines.append(
            f"  {name:<16}{source.photons:.4g} photons up to {source.maximum:g} keV, "
            f"mean {quality.mean_energy:.2f} keV, half-value layer {quality.hvl1:.3f} mm Al"
        )
    return lines


def _channel_lines(channels: list[dict[str, Any]], units: str, behind: str) -> list[str]:
    """A table of all channels."""
    width = max(10, *(len(channel["name"]) + 1 for channel in channels))
    kind = "counts" if units == "counts" else f"signal [{units}]"
    head = f"{kind} per pixel and view"
    lines = [f"{head:<{width + 24}}{'open beam':>11}  {'per photon':>10}  behind {behind}"]
    for channel in channels:
        limits = f"{channel['name']:<{width}}{channel['lower_keV']:>7g} .. {channel['upper_keV']:<7g} keV"
        numbers = f"{channel['counts']:11.4g}  {channel['share']:>10.3g}  {channel['counts_behind']:.4g}"
        lines.append(f"  {limits}{numbers}")
    return lines


def _noise_line(noise: dict[str, Any]) -> str:
    """One basis function."""
    mass = noise["behind_mg_per_cm2"]
    amount = "" if mass is None else f"  = {mass:.3g} mg/cm^2"
    return f"  {pretty(noise['basis']):<28}{_number(noise['air']):>13}  {_number(noise['behind']):>13}{amount}"


def _finite(value: float) -> float | None:
    """A number that JSON can hold."""
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> str:
    """A number for people."""
    return "unbounded" if value is None else f"{value:.4g}"
