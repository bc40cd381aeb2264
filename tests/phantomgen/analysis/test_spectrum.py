"""Air kerma at the isocentre: energy times absorption of air, by the inverse square of distance."""

import pytest

import phantomgen
from phantomgen.analysis.spectrum import SpectrumReport

MONO = "source={type: monochromatic, energy: 60, photons: 1.0e5}"
ORBITS = {
    "circular": "{type: circular, sod: 500, sdd: 800, views: 30, test_views: 10}",
    "helical": "{type: helical, sod: 500, sdd: 800, views: 30, pitch: 40, turns: 2, test_views: 10}",
    "laminography": "{type: laminography, sod: 500, sdd: 800, tilt: 30, views: 30, test_views: 10}",
    "parallel": "{type: parallel, distance: 300, views: 30, test_views: 10}",
}


@pytest.mark.parametrize("orbit", ORBITS)
def test_kerma_at_the_isocentre_is_that_of_the_fluence_there(orbit):
    scan = phantomgen.load("kedge-small", [MONO, f"geometry={ORBITS[orbit]}", "detector.thresholds=[20]"])
    report = SpectrumReport.of(scan)
    panel = scan.geometry.panel
    per_mm2 = 1e5 / (panel.row_pitch * panel.column_pitch) * (1.0 if orbit == "parallel" else (800 / 500) ** 2)
    joule, mm2_per_kg = 60 * 1.602176634e-16, 0.03041 * 1e5  # NIST SRD 126: 0.03041 cm^2/g for dry air at 60 keV
    assert report.kerma_at_isocentre == pytest.approx(40 * per_mm2 * joule * mm2_per_kg, rel=2e-3)
    assert "per scan at the isocentre" in report.text


def test_a_modulated_current_has_the_same_kerma_and_stated_factors_have_their_sum():
    tube = "source={type: tube, kvp: 100, photons: 1.0e5, modulation: MODULATION}"
    common = ["geometry.views=8", "geometry.test_views=2"]
    found = []
    for text in ("null", "{strength: 0.5}", "{factors: [1, 2, 3, 4, 5, 6, 7, 8, 9, 10]}"):
        scan = phantomgen.load("kedge-small", [tube.replace("MODULATION", text), *common])
        found.append(SpectrumReport.of(scan).kerma_at_isocentre)
    assert found == pytest.approx([found[0], found[0], 5.5 * found[0]])
