"""Objects that several tests of `spectra` share."""

import pytest

from spectra.basis.basis import Basis, BasisFunction
from spectra.detector.detector import Detector
from spectra.materials.material import Material
from spectra.source.source import Filter, Source
from spectra.transmission import Transmission

ALUMINIUM = Material("aluminium", composition="Al")
LOWEST = 20.0


@pytest.fixture(scope="session")
def tube():
    """140 kVp, 12 degrees, 2.5 mm Al, 2e5 photons."""
    return Source.tube(140, 2e5, 12, [Filter(ALUMINIUM, 2.5)])


@pytest.fixture(scope="session")
def detector():
    return Detector.photon_counting([20, 45, 63.3, 80], top=140)


@pytest.fixture(scope="session")
def basis():
    return Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3)))


@pytest.fixture(scope="session")
def transmission_on(tube, detector, basis):
    """Transmission of the shared scan on a grid of about `count` bins."""

    def build(count):
        energies, photons = tube.sampled(tube.grid(LOWEST, count, (*detector.breaks, *basis.breaks)))
        weights = detector.response(energies) * photons
        return Transmission.from_spectrum(weights, basis.evaluate(energies.nodes), detector.names)

    return build
