"""Electron densities of compositions and of coefficients."""

import numpy as np
import pytest

from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import mass_attenuation
from spectra.errors import InputError
from spectra.materials.electron_density import electron_density
from spectra.materials.material import Material

BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=60.0)))


def test_water_has_as_many_electrons_as_tables_say():
    # 10 electrons in 18.015 g/mol: 3.3428e23 per cm^3; xraylib rounds the atomic weight of hydrogen to 1.01
    assert electron_density(Material("water", 1.0, "H2O"), BASIS) == pytest.approx(3.3428e20, rel=5e-4)


def test_compton_coefficients_are_those_of_free_electrons():
    # Klein-Nishina cross section at 70 keV, 0.5315 barn (Hubbell 1975: 0.5440 at 60, 0.5199 at 80 keV)
    water = Material("water", coefficients={"compton": 3.3428e20 * 0.5315e-22, "photoelectric": 0.001})
    assert electron_density(water, BASIS) == pytest.approx(3.3428e20, rel=2e-3)
    assert electron_density(Material("dye", coefficients={"kedge_60": 0.01}), BASIS) == 0.0


def test_functions_of_matter_count_its_electrons():
    basis = Basis((BasisFunction("material", composition="H2O", name="water"), BasisFunction("element", element="I")))
    water = {"water": mass_attenuation("H2O", np.array([70.0]))[0] / 10}
    assert electron_density(Material("w", coefficients=water), basis) == pytest.approx(3.3428e20, rel=5e-4)
    dye = electron_density(Material("dye", coefficients={"kedge_I": 0.01}), basis)
    density = 10 * 0.01 / mass_attenuation("I", np.array([70.01]))[0]
    assert dye == pytest.approx(electron_density(Material("i", density, "I"), basis), rel=1e-9)


def test_svd_functions_are_refused():
    basis = Basis((BasisFunction("svd", composition=(("H", 0.5), ("O", -0.5)), name="svd_1"),))
    with pytest.raises(InputError, match="how many electrons"):
        electron_density(Material("x", coefficients={"svd_1": 0.1}), basis)
