"""Named materials: complete, consistent, and not at odds with NIST where both know a tissue."""

import numpy as np
import pytest

from spectra.elements.attenuation import atomic_number, mass_attenuation, mass_fractions, natural_density, nist_names
from spectra.elements.named_materials import ELEMENTS, GROUPS, LIBRARY, TISSUES, element_number, near
from spectra.errors import InputError
from spectra.materials.material import Material

# NIST SRD 126, tables 2 and 4: mu/rho with coherent scattering [cm^2/g] of ICRU-44 tissues.
NIST = {
    "adipose": (0.95, {20: 5.677e-1, 60: 1.974e-1, 100: 1.688e-1}),
    "blood": (1.06, {20: 8.428e-1, 60: 2.057e-1, 100: 1.695e-1}),
    "brain": (1.04, {60: 2.058e-1, 100: 1.701e-1}),
    "breast": (1.02, {20: 6.889e-1, 60: 2.006e-1, 100: 1.688e-1}),
    "cortical bone": (1.92, {20: 4.001, 60: 3.148e-1, 100: 1.855e-1}),
    "soft tissue": (1.06, {20: 8.230e-1, 60: 2.048e-1, 100: 1.693e-1}),
    "muscle": (1.05, {20: 8.205e-1, 60: 2.048e-1, 100: 1.693e-1}),
    "lung": (1.05, {20: 8.316e-1, 60: 2.053e-1, 100: 1.695e-1}),
}


@pytest.mark.parametrize("name", NIST)
def test_tissues_attenuate_as_nist_prints(name):
    density, printed = NIST[name]
    assert natural_density(name) == density
    np.testing.assert_allclose(
        mass_attenuation(name, np.array(list(printed), dtype=float)), list(printed.values()), rtol=1e-3
    )


@pytest.mark.parametrize("name", TISSUES)
def test_mass_fractions_of_every_tissue_sum_to_one(name):
    composition = TISSUES[name].composition
    assert sum(composition.values()) == pytest.approx(1.0, abs=1e-9)
    assert 0.9 < TISSUES[name].density < 2


@pytest.mark.parametrize("name", LIBRARY)
def test_every_entry_is_a_material_with_a_source(name):
    material = Material(name, composition=name)
    assert material.density == LIBRARY[name].density
    assert LIBRARY[name].source
    assert material.attenuation(np.array([60.0]))[0] > 0


def test_other_names_have_the_density_that_nist_has():
    for group in GROUPS.values():
        for name, entry in group.items():
            if entry.source.startswith("NIST"):
                assert entry.density == natural_density(entry.composition), name


def test_no_entry_hides_a_nist_name_or_an_element():
    assert not set(LIBRARY) & set(nist_names())
    for name in LIBRARY:
        with pytest.raises(InputError):
            atomic_number(name)


@pytest.mark.parametrize(
    ("name", "elements"),
    [
        ("hydroxyapatite", {20: 0.3989, 15: 0.1850, 8: 0.4141, 1: 0.0020}),
        ("Delrin", {1: 0.0671, 6: 0.4000, 8: 0.5329}),
        ("CZT", {30: 0.0278, 48: 0.4299, 52: 0.5423}),
        ("PVC", {1: 0.0484, 6: 0.3844, 17: 0.5672}),
    ],
)
def test_compounds_have_the_mass_fractions_of_their_formula(name, elements):
    assert dict(mass_fractions(name)) == pytest.approx(elements, abs=3e-4)


def test_names_of_elements_stand_at_their_number():
    assert len(ELEMENTS) == 98
    for name, symbol in {"iodine": "I", "Gold": "Au", "tungsten": "W", "aluminum": "Al", "californium": "Cf"}.items():
        assert element_number(name) == atomic_number(symbol)
    assert element_number("adamantium") is None


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("LIVER", "liver"),
        ("livr", "liver"),
        ("water, liquid", "Water, Liquid"),
        ("Bone cortical (ICRP)", "Bone, Cortical (ICRP)"),
        ("iodine", "I"),
        ("Sulphur", "S"),
        ("pmma", "PMMA"),
        ("cdte", "CdTe"),
        ("Calcium carb", "Calcium Carbonate"),
    ],
)
def test_a_near_miss_is_hinted_at(word, meant):
    with pytest.raises(InputError, match="did you mean") as caught:
        mass_fractions(word)
    assert f"did you mean {meant!r}?" in str(caught.value)


def test_nothing_is_near_nonsense():
    assert near("qqqq", LIBRARY) is None
    assert near("W", LIBRARY) is None
