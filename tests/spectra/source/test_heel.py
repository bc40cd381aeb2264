"""The heel effect against SpekPy itself, in directions and on bins that the fit did not use."""

import numpy as np
import pytest
import spekpy
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.heel import heel_of
from spectra.source.source import Filter, Source

ALUMINIUM = Material("aluminium", composition="Al")
TIN = Material("tin", composition="Sn")
# NIST SRD 126: mass energy-absorption coefficient of dry air [cm^2/g].
AIR = (
    [10, 15, 20, 30, 40, 50, 60, 80, 100, 150],
    [4.742, 1.334, 0.5389, 0.1537, 0.06833, 0.04098, 0.03041, 0.02407, 0.02325, 0.02496],
)
EIGHT = np.deg2rad(8.0)


def half_value_layer(energy, photons):
    """First half-value layer of the air kerma [mm Al]."""
    kept = photons > 0
    energy, photons = energy[kept], photons[kept]
    kerma = photons * energy * np.exp(CubicSpline(*np.log(AIR))(np.log(energy)))
    mu = ALUMINIUM.attenuation(energy)
    return brentq(lambda t: kerma @ np.exp(-mu * t) - kerma.sum() / 2, 0.01, 40)


def towards(source, heel, angle):
    """Mean energies and photons of a source in one direction, in bins with the lines apart."""
    energies, photons = source.sampled(source.grid(10, 500))
    curves = np.stack([curve.attenuation(energies.nodes) for curve in heel.curves])
    return energies.nodes, photons * np.exp(-heel.amplitudes_at(np.array(angle)) @ curves)


@pytest.mark.parametrize("kvp", [80, 120, 140])
@pytest.mark.parametrize("sheets", [[("Al", 2.5)], [("Al", 2.5), ("Sn", 0.5)]], ids=["Al", "Sn"])
def test_fluence_and_hardness_beside_the_axis_are_those_of_spekpy(kvp, sheets):
    material = {"Al": ALUMINIUM, "Sn": TIN}
    source = Source.tube(kvp, None, filters=[Filter(material[name], t) for name, t in sheets])
    heel = heel_of(source, kvp, 12, "tungsten", -EIGHT, EIGHT)
    theirs = spekpy.Spek(kvp=kvp, th=12, dk=0.25, physics="casim", mu_data_source="nist", obli=False)
    theirs.multi_filter(sheets)

    def spek(angle, across=0.0):
        x = -100 * np.tan(angle)
        energy, fluence = theirs.get_spectrum(x=x, y=across, z=100, flu=True, diff=False)
        return energy, np.where(energy > 10, fluence, 0) * (1 + (x**2 + across**2) / 1e4)  # at equal distance

    ours_0, spek_0 = towards(source, heel, 0.0), spek(0.0)
    for degrees, across in [(-7.7, 0), (-4.1, 15), (3.3, 0), (6.1, -15), (7.9, 15)]:  # [cm] at 1 m
        angle = np.deg2rad(degrees)
        ours, wanted = towards(source, heel, angle), spek(angle, across)
        assert ours[1].sum() / ours_0[1].sum() == pytest.approx(wanted[1].sum() / spek_0[1].sum(), rel=2e-3)
        hardness = half_value_layer(*ours) / half_value_layer(*ours_0)
        assert hardness == pytest.approx(half_value_layer(*wanted) / half_value_layer(*spek_0), rel=2e-3)


def test_nothing_changes_on_the_axis():
    source = Source.tube(120, None, filters=[Filter(ALUMINIUM, 2.5)])
    heel = heel_of(source, 120, 12, "tungsten", -0.05, 0.1)
    assert heel.amplitudes_at(np.zeros((2, 3))) == pytest.approx(0, abs=1e-12)
    assert (heel.amplitudes_at(np.array([0.1])) > 0)[0]  # less towards the anode


def test_a_narrow_panel_needs_fewer_curves():
    source = Source.tube(120, None, filters=[Filter(ALUMINIUM, 2.5)])
    counts = [len(heel_of(source, 120, 12, "tungsten", -a, a).curves) for a in np.deg2rad([0.5, 8.0])]
    assert counts == [1, 2]


def test_half_value_layers_across_a_field_of_20_cm():
    # Noted of SpekPy casim: 120 kVp, 12 degrees, behind 2.5 mm Al at 100 cm, at x = -10, -5, 0, 5, 10 cm (anode at -x).
    source = Source.tube(120, None, filters=[Filter(ALUMINIUM, 2.5)])
    angles = np.arctan(-np.array([-10, -5, 0, 5, 10]) / 100)
    heel = heel_of(source, 120, 12, "tungsten", angles.min(), angles.max())
    found = np.array([half_value_layer(*towards(source, heel, angle)) for angle in angles])
    assert found / found[2] == pytest.approx(np.array([4.83, 4.46, 4.22, 4.05, 3.92]) / 4.22, rel=5e-3)


def test_a_panel_in_the_shadow_of_the_anode_is_refused():
    with pytest.raises(InputError, match=r"1 degree or more, but those to the panel's edge at \+z leave it at -2"):
        heel_of(Source.tube(120, None), 120, 12, "tungsten", -0.2, np.deg2rad(14))
