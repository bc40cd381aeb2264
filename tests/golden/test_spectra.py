"""Numbers of `spectra` against printed tables, another program, and measured beams; sources stand in the tables."""

import csv
from pathlib import Path

import numpy as np
import pytest

from spectra.basis.basis import klein_nishina
from spectra.elements.attenuation import mass_attenuation
from spectra.materials.material import Material
from spectra.source import tube
from spectra.source.beam_quality import ALUMINIUM, COPPER, BeamQuality, half_value_layers
from spectra.source.source import Filter, Source

HERE = Path(__file__).parent
METALS = {name: Material(name, composition=name) for name in ("Al", "Cu", "Sn")}
# Beyond the 5 % asked of all others; the laboratory states two filtrations for it.
DOUBTFUL = {"CCRI-135": "its filtration is stated twice and differently"}


def table(name: str) -> list[dict[str, str]]:
    with (HERE / name).open(encoding="utf-8") as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


PRINTED = table("nist_mu_rho.csv")
SPEKPY = table("spekpy_quality.csv")
MEASURED = [
    pytest.param(row, id=row["quality"], marks=[pytest.mark.xfail(reason=DOUBTFUL[row["quality"]])])
    if row["quality"] in DOUBTFUL
    else pytest.param(row, id=row["quality"])
    for row in table("measured_beams.csv")
]


def test_the_printed_table_is_large_enough_to_mean_something():
    assert len(PRINTED) >= 100
    assert len({row["material"] for row in PRINTED}) >= 12


@pytest.mark.parametrize("material", sorted({row["material"] for row in PRINTED}))
def test_attenuation_is_that_printed_by_nist(material):
    rows = [row for row in PRINTED if row["material"] == material]
    energy, printed = (np.array([float(row[key]) for row in rows]) for key in ("energy_keV", "mu_rho_cm2_per_g"))
    # Found: 0.05 % at most, half a unit in the last of four printed digits.
    np.testing.assert_allclose(mass_attenuation(material, energy), printed, rtol=1e-3)


@pytest.mark.parametrize("row", SPEKPY, ids=lambda row: f"{row['kvp']} kV, {row['filters_mm']}")
def test_beam_quality_is_that_of_spekpy(row):
    sheets = [sheet.split() for sheet in row["filters_mm"].split(" + ")]
    filters = [Filter(METALS[name], float(thickness)) for thickness, name in sheets]
    source = Source.tube(float(row["kvp"]), 1e5, 12, filters)
    quality = BeamQuality.of(source)
    assert quality.mean_energy == pytest.approx(float(row["mean_keV"]), abs=0.3)
    assert quality.hvl1 == pytest.approx(float(row["hvl1_mm_Al"]), rel=0.01)
    assert quality.hvl2 == pytest.approx(float(row["hvl2_mm_Al"]), rel=0.01)
    assert quality.kerma_per_fluence == pytest.approx(float(row["kerma_Gy_mm2"]), rel=0.02)
    # SpekPy interpolates NIST's printed nodes along straight lines of the logarithms: up to 1.7 % high between them.
    assert half_value_layers(source, COPPER)[0] == pytest.approx(float(row["hvl1_mm_Cu"]), rel=0.02)


@pytest.mark.parametrize("row", MEASURED)
def test_half_value_layers_are_those_of_measured_beams(row, monkeypatch):
    # The laboratory's industrial tubes have 30 degrees, more than the program lets scenes ask for.
    monkeypatch.setattr(tube, "_checked", lambda *_: "W")
    sheets = [(METALS[name], float(row[f"{name}_mm"])) for name in METALS]
    sheets.append((Material("air", composition="air"), float(row["air_mm"])))
    source = Source.tube(float(row["kvp"]), 1e5, 30.0, [Filter(m, thickness) for m, thickness in sheets if thickness])
    layer = {"Al": ALUMINIUM, "Cu": COPPER}[row["layer"]]
    assert half_value_layers(source, layer)[0] == pytest.approx(float(row["hvl_mm"]), rel=0.05)


@pytest.mark.parametrize(("energy", "barn"), [(20, 0.617987), (70, 0.530923), (140, 0.452295)])
def test_klein_nishina_is_the_cross_section_of_a_free_electron(energy, barn):
    # In barn per electron, to the last digit; formula: Evans 1955, The Atomic Nucleus, section 23.3.
    unit = 2 * np.pi * 2.8179403205e-13**2 * 1e24
    assert klein_nishina(np.array([float(energy)]))[0] * unit == pytest.approx(barn, abs=5e-7)
