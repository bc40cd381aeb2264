"""Writes spekpy_quality.csv: beam quality as SpekPy computes it, from its own spectra, filters, layers and kerma.

    python tests/golden/make_spekpy_quality.py

SpekPy 2.5.4, model casim, anode angle 12 degrees, bins of 0.1 keV, attenuation data `nist`. The choice matters behind
tin: with SpekPy's default bins of 0.5 keV, one of which holds tin's K edge, and its default PENELOPE data, which differ
from NIST's by some per cent there, the half-value layer at 80 kV is 6.06 mm Al in place of 6.18.
"""

import csv
from pathlib import Path

import spekpy

VOLTAGES = (80, 100, 120, 140)
FILTERS = ("2.5 Al", "6 Al", "2.5 Al + 0.5 Sn", "2.5 Al + 0.5 Cu")
HEADER = ("kvp", "filters_mm", "mean_keV", "hvl1_mm_Al", "hvl2_mm_Al", "hvl1_mm_Cu", "kerma_Gy_mm2")


def main() -> None:
    rows = []
    for kvp in VOLTAGES:
        for filters in FILTERS:
            tube = spekpy.Spek(kvp=kvp, th=12, dk=0.1, physics="casim", mu_data_source="nist")
            for sheet in filters.split(" + "):
                thickness, material = sheet.split()
                tube.filter(material, float(thickness))
            kerma = tube.get_kerma() * 1e-6 / tube.get_flu() * 100  # uGy cm^2 to Gy mm^2
            layers = tube.get_hvl1(), tube.get_hvl2(), tube.get_hvl1(matl="Cu")
            values = (tube.get_emean(), *layers, kerma)
            rows.append((kvp, filters, *(f"{value:.6g}" for value in values)))
    with Path(__file__).with_name("spekpy_quality.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([HEADER, *rows])


if __name__ == "__main__":
    main()
