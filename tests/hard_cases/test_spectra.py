"""Energies, formulas, filters and tubes at which tables and programs below this one go silently wrong."""

import warnings

import numpy as np
import pytest
import spekpy
import xraylib

from spectra.detector.detector import Detector
from spectra.elements.attenuation import atomic_number, edge_energy, mass_attenuation, mass_fractions
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.beam_quality import BeamQuality, half_value_layers, mean_energy
from spectra.source.source import Filter, Source

ALUMINIUM, LEAD, TIN = (Material(symbol, composition=symbol) for symbol in ("Al", "Pb", "Sn"))
EDGES = ("I", "Ba", "Gd", "Yb", "Lu", "W", "Au", "Pb", "Bi", "Sn")


@pytest.fixture(autouse=True)
def _no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize("energy", [np.nan, np.inf, -np.inf, -1.0, 0.0, 0.05, 0.999, 800.5, 1000.0, 6e4])
def test_an_energy_out_of_range_is_refused_with_range_and_value(energy):
    with pytest.raises(InputError, match=rf"known from 1 to 800 keV, not at {energy:g} keV"):
        mass_attenuation("H2O", np.array([60.0, energy]))


@pytest.mark.wrong_types
@pytest.mark.parametrize("energy", [60, 60.0, np.float32(60), np.array(60), np.array([60], np.int64), [60]])
def test_an_energy_of_any_type_of_number_is_taken(energy):
    np.testing.assert_allclose(mass_attenuation("Water, Liquid", energy), [0.2059], rtol=1e-3)


@pytest.mark.parametrize("energy", [1.0, 800.0])
def test_the_ends_of_the_range_belong_to_it(energy):
    assert np.isfinite(mass_attenuation("Pb", np.array([energy]))).all()


@pytest.mark.parametrize("element", EDGES)
def test_exactly_on_an_edge_the_upper_branch_counts(element):
    edge = edge_energy(element)
    below, on, above = mass_attenuation(element, edge + np.array([-0.01, 0.0, 0.01]))
    assert on == pytest.approx(above, rel=2e-3)
    assert on > 3.5 * below


def test_the_table_below_jumps_beside_its_own_edges():
    # What the few eV around edges are kept clear of: at the edge that it reports, xraylib gives the lower branch of
    # iodine and the upper one of tungsten.
    def branch(number: int) -> float:
        edge = xraylib.EdgeEnergy(number, xraylib.K_SHELL)
        return xraylib.CS_Total(number, edge) / xraylib.CS_Total(number, edge + 0.01)

    assert branch(53) < 0.3
    assert branch(74) > 0.9


@pytest.mark.wrong_types
@pytest.mark.parametrize("element", ["Es", "Fm", "Og", "Xx", "", " ", "h", "Lutetium", "1", 0, 1, 99])
def test_what_is_no_element_of_the_table_is_named(element):
    with pytest.raises(InputError, match=r"element|attenuation data"):
        atomic_number(element)


@pytest.mark.parametrize(
    ("formula", "words"),
    [
        ("CsI(Tl)", r"bracket in 'CsI\(Tl\)' has no number behind it"),
        ("CaSO4.2H2O", "'CaSO4.2H2O' reads like a hydrate"),
        ("H0.1119O0.8881", "'H0.1119O0.8881' would be taken as atoms"),
        ("CO", "may mean Co or C and O"),
        ("SN", "may mean Sn or S and N"),
        ("h2o", "unknown material 'h2o'"),
        ("", "unknown material ''"),
        ("2H2O", "unknown material '2H2O'"),
        ("Gd2O2S:Tb", "unknown material 'Gd2O2S:Tb'"),
        ("Ca(OH2", r"unknown material 'Ca\(OH2'"),
        ("Ca)OH(2", "no number behind it"),
        ("D2O", "unknown material 'D2O'"),
        ("WATER, LIQUID", "did you mean 'Water, Liquid'"),
        ("Unobtainium", "unknown material 'Unobtainium'"),
        ("H2O\n", None),
        (" H2O", None),
        ("H2O ", None),
    ],
)
def test_a_formula_is_read_as_meant_or_refused_with_its_text(formula, words):
    if words is None:
        assert mass_fractions(formula) == mass_fractions("H2O")
        return
    with pytest.raises(InputError, match=words):
        mass_fractions(formula)


def test_a_dopant_read_as_an_atom_would_be_44_per_cent_of_the_mass():
    # Why the bracket is refused.
    parsed = xraylib.CompoundParser("CsI(Tl)")
    assert dict(zip(parsed["Elements"], parsed["massFractions"], strict=True))[81] == pytest.approx(0.44, abs=0.005)


def test_subscripts_read_as_atoms_would_give_7_per_cent_less_attenuation():
    wrong = xraylib.CS_Total_CP("H0.1119O0.8881", 60.0)
    right = mass_attenuation({"H": 0.1119, "O": 0.8881}, np.array([60.0]))[0]
    assert wrong == pytest.approx(0.1918, rel=1e-3)
    assert right == pytest.approx(0.2059, rel=1e-3)


@pytest.mark.parametrize(
    ("composition", "words"),
    [
        ({"H": 0.11, "O": 0.88}, "sum to 1, those of H, O sum to 0.99"),
        ({"H": 11.19, "O": 88.81}, "between 0 and 1"),
        ({"H": -0.1, "O": 1.1}, "between 0 and 1"),
        ({"H": np.nan, "O": 1.0}, "between 0 and 1"),
        ({}, "at least one element"),
        ({"H2": 0.5, "O": 0.5}, "unknown element 'H2'"),
    ],
)
def test_mass_fractions_that_are_none_are_refused(composition, words):
    with pytest.raises(InputError, match=words):
        mass_fractions(composition)


@pytest.mark.parametrize("density", [None, 0.0, -1.0, np.nan, np.inf, 1000.0])
def test_a_density_is_never_assumed(density):
    with pytest.raises(InputError, match="density"):
        Material("oxide", density, "Gd2O3")


@pytest.mark.parametrize(
    ("wish", "words"),
    [
        ({"kvp": 9}, "from 10 to 500 kV, got 9"),
        ({"kvp": 501}, "from 10 to 500 kV, got 501"),
        ({"kvp": np.nan}, "from 10 to 500 kV, got nan"),
        ({"kvp": np.inf}, "from 10 to 500 kV, got inf"),
        ({"kvp": -120}, "from 10 to 500 kV, got -120"),
        ({"kvp": 80, "anode": "molybdenum"}, "molybdenum tube works from 10 to 50 kV, got 80"),
        ({"anode": "adamantium"}, "unknown anode 'adamantium': choose from tungsten"),
        ({"angle": 0}, r"5 \.\. 25 degrees, got 0"),
        ({"angle": -5}, r"5 \.\. 25 degrees, got -5"),
        ({"angle": 90}, r"5 \.\. 25 degrees, got 90"),
        ({"angle": np.nan}, r"5 \.\. 25 degrees, got nan"),
        ({"photons": 0}, "photons must be positive, got 0"),
        ({"photons": -1}, "photons must be positive, got -1"),
        ({"photons": np.nan}, "photons must be positive, got nan"),
        ({"photons": np.inf}, "photons must be positive, got inf"),
    ],
)
def test_an_impossible_tube_is_refused_before_any_table_is_read(wish, words):
    with pytest.raises(InputError, match=words):
        Source.tube(**{"kvp": 120, "photons": 1e5, **wish})


@pytest.mark.parametrize("thickness", [-1.0, np.nan, np.inf, -np.inf])
def test_an_impossible_filter_is_refused(thickness):
    with pytest.raises(InputError, match=f"Al filter must be finite and not negative, got {thickness:g} mm"):
        Filter(ALUMINIUM, thickness)


def test_the_model_below_would_answer_a_negative_filter_with_more_photons():
    with np.errstate(over="ignore"):
        tube = spekpy.Spek(kvp=80, dk=1.0).filter("Al", -1)
        assert tube.get_flu() > spekpy.Spek(kvp=80, dk=1.0).get_flu()


@pytest.mark.parametrize("sheets", [[100.0], [5.0] * 20])
def test_a_filter_that_leaves_nothing_is_refused_however_it_is_stacked(sheets):
    with pytest.raises(InputError, match="Pb absorb"):
        Source.tube(80, 1e5, 12, [Filter(LEAD, thickness) for thickness in sheets])


def test_a_strong_filter_still_gives_the_photons_asked_for():
    source = Source.tube(80, 1e5, 12, [Filter(LEAD, 3.0)])
    assert source.photons == pytest.approx(1e5, rel=1e-12)
    quality = BeamQuality.of(source)
    assert 70 < quality.mean_energy < 80
    assert 0.95 < quality.homogeneity <= 1


def test_no_filter_and_a_filter_of_no_thickness_are_the_same():
    bare, none = (Source.tube(80, 1e5, 12, filters) for filters in ([], [Filter(TIN, 0.0)]))
    assert half_value_layers(none) == pytest.approx(half_value_layers(bare), rel=1e-9)


@pytest.mark.parametrize(("symbol", "edge"), [("Sn", 29.2001), ("Gd", 50.2391), ("Ta", 67.4164), ("W", 69.525)])
def test_the_edge_of_a_filter_is_a_break(symbol, edge):
    source = Source.tube(140, 1e5, 12, [Filter(Material(symbol, composition=symbol), 0.1)])
    assert min(abs(b - edge) for b in source.breaks) < 1e-3
    assert min(abs(e - edge) for e in source.grid(20, 64).edges) < 1e-3


def test_a_tube_below_the_edge_of_its_anode_has_no_lines_of_the_k_shell():
    low, high = (Source.tube(kvp, 1e5, 12, [Filter(ALUMINIUM, 2.5)]) for kvp in (69.0, 71.0))
    edge = edge_energy("W")
    assert low.line_energy.max() < 15
    assert edge not in low.breaks
    assert high.line_energy.max() > 55
    assert edge in high.breaks


@pytest.mark.parametrize("kvp", [40.0, 80.0, 80.3, 119.97])
def test_a_spectrum_ends_at_its_voltage_whatever_the_bins_below(kvp):
    # SpekPy hangs its bins from the voltage: at 80.3 kV and 0.5 keV the last one is centred at 80.05.
    source = Source.tube(kvp, 1e5, 12, [Filter(ALUMINIUM, 2.5)])
    assert source.maximum == source.energy[-1] == kvp
    assert source.photons_in(np.array([kvp, kvp + 10]))[0][0] == 0
    assert source.photons_in(np.array([kvp - 1, kvp]))[0][0] > 0


def test_bins_finer_than_the_table_conserve_photons_and_energy():
    source = Source.tube(80, 1e5, 12, [Filter(ALUMINIUM, 2.5)])
    fine, mean = source.photons_in(np.linspace(59.0, 60.0, 100_001))
    whole, middle = source.photons_in(np.array([59.0, 60.0]))
    assert fine.sum() == pytest.approx(whole[0], rel=1e-9)
    assert fine @ mean == pytest.approx(whole[0] * middle[0], rel=1e-9)


def test_a_channel_above_the_voltage_is_refused_and_never_divides_by_zero():
    with pytest.raises(
        InputError, match="channel bin2 starts at 90 keV and sees no photons: the source ends at 80 keV"
    ):
        Detector.photon_counting([20, 50, 90], 80)


@pytest.mark.parametrize("energy", [33.1694, 50.2391, 69.525])
def test_one_energy_on_an_edge_is_one_energy(energy):
    source = Source.monochromatic(energy, 1e5)
    energies, photons = source.sampled(source.grid(20, 64, (energy,)))
    assert (len(energies), photons.sum(), mean_energy(source)) == (1, pytest.approx(1e5), pytest.approx(energy))
    material = Material("iodine", composition="I")
    first, second = half_value_layers(source, material)
    assert first == pytest.approx(np.log(2) / material.attenuation(np.array([energy]))[0], rel=1e-12)
    assert second == pytest.approx(first, rel=1e-9)


def test_an_edge_inside_a_bin_is_what_breaks_are_for():
    # Behind 30 mg/cm^2 of iodine, one bin of 20 .. 45 keV: the mean energy's attenuation is not the mean attenuation.
    source = Source.tube(120, 1e5, 12, [Filter(ALUMINIUM, 2.5)])
    iodine, thickness = Material("iodine", 1.0, {"I": 1.0}), 0.3
    edge = edge_energy("I")

    def behind(energies: Energies) -> float:
        nodes, photons = source.sampled(energies)
        return float(-np.log(photons @ np.exp(-thickness * iodine.attenuation(nodes.nodes)) / photons.sum()))

    exact = behind(Energies.snapped(20, 45, 2500, (edge,)))
    whole, split = (behind(Energies.snapped(20, 45, 1, breaks)) for breaks in ((), (edge,)))
    assert abs(whole - exact) > 0.1
    assert abs(split - exact) < 0.3 * abs(whole - exact)
