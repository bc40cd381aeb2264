"""Energy-integrating detectors: a scintillator whose light is proportional to the energy that it absorbs.

A photon that is absorbed adds its energy E to the signal, so a photon that arrives adds E (1 - exp(-mu t)) on average.
The number of absorbed photons of each energy is Poisson, the signal therefore *compound* Poisson: its variance is the
sum of E^2 over the absorbed photons, some 10 % more than that of as many photons of one energy. Left out are
fluorescence that leaves the scintillator, the spread of light per photon (Swank noise), its depth dependence, scatter
inside the scintillator and electronic noise.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from jaxtyping import Float

from spectra.detector.detector import AnyDetector, Channel, absorbed
from spectra.elements.attenuation import LOWEST_ENERGY
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Source

# Energies are measured from where less than this part of the open-beam signal lies below.
_NEGLIGIBLE = 1e-6


@dataclass(frozen=True)
class Scintillator:
    """Scintillator as it is usually made.

    Parameters
    ----------
    composition : formula
    density : nominal density, packing included [g/cm^3]
    thickness : usual thickness [mm]
    """

    composition: str
    density: float
    thickness: float


# Nominal: needles of CsI fill about 80 % of their layer, powder screens 60 %; ceramics and crystals are dense.
SCINTILLATORS = MappingProxyType(
    {
        "CsI": Scintillator("CsI", 3.6, 0.6),
        "GOS": Scintillator("GOS", 7.34, 1.4),
        "GOS screen": Scintillator("GOS", 4.5, 0.2),
        "CdWO4": Scintillator("CdWO4", 7.9, 2.0),
    }
)


@dataclass(frozen=True)
class EnergyIntegrating(AnyDetector):
    """Energy-integrating detector: one channel that adds the energies of all absorbed photons [keV].

    Parameters
    ----------
    channels : one, as wide as the part of the spectrum that matters
    material : of the scintillator
    thickness : of the scintillator [mm]
    """

    material: Material
    thickness: float

    def __post_init__(self) -> None:
        if len(self.channels) != 1:
            raise InputError(f"an energy-integrating detector has one channel, not {len(self.channels)}")
        if not 0 < self.thickness < np.inf:
            raise InputError(f"the scintillator thickness must be positive and finite, got {self.thickness:g} mm")

    @classmethod
    def behind(
        cls, source: Source, material: Material | str = "CsI", thickness: float | None = None
    ) -> "EnergyIntegrating":
        """Create a detector for a source.

        Parameters
        ----------
        source : its energies bound the channel
        material : of the scintillator, or a name of `SCINTILLATORS`
        thickness : of the scintillator [mm]; that of `SCINTILLATORS` where left out

        Returns
        -------
        the detector

        Raises
        ------
        InputError
            When a scintillator that is not in `SCINTILLATORS` has no thickness.
        """
        if isinstance(material, str):
            usual = usual_scintillator(material)
            thickness = usual.thickness if thickness is None else thickness
            material = Material(material, usual.density, usual.composition)
        if thickness is None:
            raise InputError(f"a scintillator of {material.name} needs a thickness in mm")
        whole = cls((Channel("signal", LOWEST_ENERGY, source.maximum),), material, float(thickness))
        return cls((Channel("signal", whole._first_energy(source), source.maximum),), material, float(thickness))

    @property
    def units(self) -> str:
        """Unit of the signal, an energy."""
        return "keV"

    @property
    def lowest_scattered(self) -> float:
        """Lowest energy of attenuation [keV], as `lowest` is where the photons of the source begin."""
        return LOWEST_ENERGY

    @property
    def breaks(self) -> tuple[float, ...]:
        """K edges of the scintillator [keV]."""
        return self.material.k_edges(self.lowest, self.channels[0].upper)

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the mean signal of a photon, E (1 - exp(-mu t)).

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        signal per photon [keV], (1, energy)
        """
        return (energies.nodes * absorbed(self.material, self.thickness, energies.nodes))[None]

    def variance(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Compute the variance that a photon adds to the signal, E^2 (1 - exp(-mu t)).

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        variance per photon [keV^2], (1, energy)
        """
        return energies.nodes * self.response(energies)

    def _first_energy(self, source: Source) -> float:
        """Whole energy below which nearly nothing of the signal lies [keV]."""
        steps = np.arange(LOWEST_ENERGY, max(source.maximum, LOWEST_ENERGY + 1))
        energies, photons = source.sampled(Energies.from_edges(np.append(steps, max(source.maximum, steps[-1]) + 1e-3)))
        below = np.append(0.0, np.cumsum(photons * self.response(energies)[0]))
        if not below[-1] > 0:
            raise InputError(f"the source has no photons above {LOWEST_ENERGY:g} keV that a scintillator could absorb")
        return float(steps[np.flatnonzero(below[:-1] <= _NEGLIGIBLE * below[-1])[-1]])


def usual_scintillator(name: str) -> Scintillator:
    """Return a scintillator by its name.

    Parameters
    ----------
    name : key of `SCINTILLATORS`

    Returns
    -------
    composition, density and usual thickness

    Raises
    ------
    InputError
        When the name is unknown.
    """
    if name not in SCINTILLATORS:
        raise InputError(
            f"unknown scintillator {name!r}: choose from {_listed(SCINTILLATORS)}, or give density and thickness"
        )
    return SCINTILLATORS[name]


def _listed(names: Iterable[str]) -> str:
    """Names in quotes."""
    return ", ".join(map(repr, names))
