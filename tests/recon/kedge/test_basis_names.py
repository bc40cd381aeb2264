"""Basis functions as users ask for them."""

import numpy as np
import pytest
from support.one_channel_scans import WATER, one_channel_scan

from recon.data.measurements import read_measurements
from recon.kedge.basis_names import OnCurve, bases_text, parse_bases, with_named
from recon.voxel.iterative.one_step import OneStep
from spectra.elements.attenuation import linear_attenuation, mass_fractions, symbol

STRENGTH = 0.03  # part of the mass that is iodine
SOLUTION = {
    "density": 1.03,
    "composition": {"I": STRENGTH} | {symbol(n): (1 - STRENGTH) * part for n, part in mass_fractions("H2O")},
}
MATERIALS = {"water": {"composition": "water"}, "solution": SOLUTION}
VIAL = {"type": "cylinder", "material": "solution", "center": [12, -10, 0], "radius": 9, "length": 70}
SMALL = {"panel": {"rows": 16, "columns": 60, "pitch": 3}, "volume": {"voxels": 32, "size": 80}}


@pytest.mark.parametrize("asked", [2, ("photoelectric", "compton"), OnCurve(), OnCurve(("water", "Ti"))])
def test_bases_are_written_as_they_are_read(asked):
    assert parse_bases(bases_text(asked)) == asked


@pytest.fixture(scope="module")
def vial(tmp_path_factory):
    """A vial of 30.9 mg/ml of iodine in water, one channel, without noise."""
    path = tmp_path_factory.mktemp("vial") / "vial.h5"
    with one_channel_scan(path, WATER, VIAL, materials=MATERIALS, noise=False, **SMALL) as dataset:
        yield dataset


@pytest.mark.parametrize(
    ("materials", "functions"),
    [
        (OnCurve().materials, ()),
        (("water", "I"), ("kedge_I",)),
        (("Au", "water", "CdTe", "Ag"), ("kedge_Ag", "kedge_Cd", "kedge_Te", "kedge_Au")),
    ],
)
def test_a_curve_has_the_k_edges_of_its_materials_that_the_beam_shows(vial, materials, functions):
    named, count = with_named(vial, OnCurve(materials))
    assert count is None
    assert named.spectra.basis.names == ("photoelectric", "compton", *functions)
    again, _ = with_named(named, OnCurve(materials))
    assert again.spectra.basis == named.spectra.basis


def test_an_edge_that_the_scan_states_is_taken_from_it(tmp_path):
    basis = [{"type": "photoelectric"}, {"type": "compton"}, {"type": "step", "edge_energy": 33.2}]
    few = {"panel": {"rows": 4, "columns": 8, "pitch": 20}, "volume": {"voxels": 4, "size": 80}}
    with one_channel_scan(tmp_path / "step.h5", WATER, VIAL, materials=MATERIALS, basis=basis, **few) as dataset:
        named, _ = with_named(dataset, OnCurve(("water", "I")))
        assert named.spectra.basis.names == ("photoelectric", "compton", "kedge_33.2")


def found_in_vial(dataset, named, curve):
    """Attenuation of vial and water at three energies, over the true one."""
    measured = read_measurements(named, named.splits["train"], separable=False)
    volumes = OneStep(curve=curve).reconstruct_counts(measured, dataset.grid)
    y, x = np.meshgrid(dataset.grid.axis("y"), dataset.grid.axis("x"), indexing="ij")
    inside, away = np.hypot(x - 12, y + 10) < 5, np.hypot(x + 12, y - 10) < 8
    energies = np.array([45.0, 70.0, 100.0])
    middle = volumes[:, volumes.shape[1] // 2]
    at = named.spectra.basis.evaluate(energies)
    solution = linear_attenuation(SOLUTION["composition"], SOLUTION["density"], energies)
    water = linear_attenuation("water", 1.0, energies)
    return middle[:, inside].mean(axis=1) @ at / solution, middle[:, away].mean(axis=1) @ at / water


def test_iodine_in_water_is_right_at_energies_on_both_sides_of_the_mean_one(vial):
    asked = OnCurve(("water", "I"))
    named, _ = with_named(vial, asked)
    solution, water = found_in_vial(vial, named, asked.curve(named))
    np.testing.assert_allclose(water, 1, atol=0.01)
    np.testing.assert_allclose(solution, 1, atol=0.02)
    bare, _ = found_in_vial(vial, vial, asked.curve(vial))  # photoelectric and Compton alone
    assert np.abs(bare - 1).max() > 2 * np.abs(solution - 1).max()
