"""Writes nist_mu_rho.csv: printed mass attenuation coefficients of NIST SRD 126.

    python tests/golden/make_nist_mu_rho.py

Hubbell, J. H. & Seltzer, S. M. (2004), Tables of X-Ray Mass Attenuation Coefficients and Mass Energy-Absorption
Coefficients (version 1.4), NIST Standard Reference Database 126, doi:10.18434/T4D01F. Coherent scattering included,
cm^2/g, energies of the printed grid from 20 to 150 keV; rows at absorption edges are left out.

Elements (table 3 there) are read from SpekPy 2.5.4 (MIT licence), which ships them as its attenuation data `nist`.
Compounds (table 4 there) are typed from the printed tables below. Nothing here goes through xraylib.
"""

import csv
import json
from pathlib import Path

import spekpy

ENERGIES = (20, 30, 40, 50, 60, 80, 100, 150)
ELEMENTS = {
    "H": 1, "C": 6, "N": 7, "O": 8, "Al": 13, "Si": 14, "Ca": 20, "Ti": 22, "Fe": 26, "Cu": 29, "Ag": 47, "Cd": 48,
    "Sn": 50, "Te": 52, "I": 53, "Ba": 56, "Gd": 64, "Yb": 70, "Lu": 71, "W": 74, "Au": 79, "Pb": 82, "Bi": 83,
}  # fmt: skip
# Names are those that `spectra` knows these materials by; NIST calls them as in brackets.
COMPOUNDS = {
    "Water, Liquid": (0.8096, 0.3756, 0.2683, 0.2269, 0.2059, 0.1837, 0.1707, 0.1505),  # (same)
    "Air, Dry (near sea level)": (0.7779, 0.3538, 0.2485, 0.2080, 0.1875, 0.1662, 0.1541, 0.1356),  # (same)
    "PMMA": (0.5714, 0.3032, 0.2350, 0.2074, 0.1924, 0.1751, 0.1641, 0.1456),  # (Polymethyl Methacrylate)
    "cortical bone": (4.001, 1.331, 0.6655, 0.4242, 0.3148, 0.2229, 0.1855, 0.1480),  # (Bone, Cortical, ICRU-44)
    "soft tissue": (0.8230, 0.3790, 0.2688, 0.2264, 0.2048, 0.1823, 0.1693, 0.1492),  # (Tissue, Soft, ICRU-44)
    "CdTe": (21.44, 21.82, 19.30, 10.67, 6.542, 3.019, 1.671, 0.6071),  # (Cadmium Telluride)
    "CsI": (26.86, 9.045, 22.97, 12.87, 7.921, 3.677, 2.035, 0.7290),  # (Cesium Iodide)
}


def main() -> None:
    table = json.loads((Path(spekpy.__file__).parent / "data/tables/nist_mu.dat").read_text())
    rows = []
    for symbol, number in ELEMENTS.items():
        printed = dict(zip(table["photon energy"][number - 1], table["mu_over_rho"][number - 1], strict=True))
        rows += [(symbol, energy, printed[energy / 1000]) for energy in ENERGIES]
    rows += [(name, *pair) for name, values in COMPOUNDS.items() for pair in zip(ENERGIES, values, strict=True)]
    with Path(__file__).with_name("nist_mu_rho.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([("material", "energy_keV", "mu_rho_cm2_per_g"), *rows])


if __name__ == "__main__":
    main()
