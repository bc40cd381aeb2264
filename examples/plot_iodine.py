"""
How much iodine is in a vial?
=============================

Above its K edge at 33.17 keV iodine absorbs 5.5 times as much as just below. A detector with a threshold there tells
it from water and acrylic, and the coefficient of its basis function says how much there is. Run it as one of::

    python examples/plot_iodine.py           # 64^3 voxels, minutes
    python examples/plot_iodine.py --quick   # 48^3 voxels, well under a minute
"""

import sys
from pathlib import Path

import numpy as np

import phantomgen
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import pure_voxels
from recon.runs.methods import method_named
from recon.runs.run_voxels import reconstruct_volumes
from spectra.elements.attenuation import mass_attenuation

QUICK = "--quick" in sys.argv[1:]
FOLDER = Path("iodine-example")
FOLDER.mkdir(exist_ok=True)
SCENE = Path(__file__).with_name("iodine.yaml")

# %%
# The scan
# --------
#
# Vials of 5, 10, 15 and 20 mg/ml and one of water. Materials are compositions: the simulator follows their exact
# attenuation, while the reconstruction knows photoelectric, Compton and the attenuation of iodine.

SMALL = ["geometry.views=30", "geometry.test_views=0", "panel={rows: 24, columns: 48, pitch: 4.27}", "volume.voxels=48"]
scan = phantomgen.load(SCENE, SMALL if QUICK else [])
print(scan)
dataset = phantomgen.make(scan, FOLDER / "iodine.h5", overwrite=True)

# %%
# The volumes
# -----------
#
# One-step reconstruction on voxels: counts of all channels at once, with a joint total variation. It is what a
# Gaussian fit starts from; its means over a vial are as good, and it takes seconds. ``recon.fit(dataset)`` would go on.

measured, _ = read_measurements(dataset, dataset.splits["train"]).compressed(1e-3)
method = method_named("one-step", None)
volumes = reconstruct_volumes(
    measured, dataset.grid, method, "two-step", Stopwatch(lambda name: None), lambda iteration: None
)
iodine = volumes[dataset.spectra.basis.names.index("kedge_I")]

# %%
# From a coefficient to mg/ml
# ---------------------------
#
# The basis function of iodine is 1 just above 70 keV, so that a coefficient is the attenuation which iodine adds there
# [1/mm]. One mg/ml adds mu/rho times 1e-3 g/cm^3, and 10 mm are a cm.

per_mg_ml = float(mass_attenuation({"I": 1.0}, np.array([70.01]))[0]) * 1e-3 / 10
print(f"1 mg/ml of iodine adds {per_mg_ml:.3e} 1/mm")

# %%
# Against what was filled in
# --------------------------
#
# Only here the truth is opened, to know where the vials are. Voxels at their walls are left out.

truth = phantomgen.read_truth(dataset.path)
filled, found = [], []
for name, fraction in zip(truth.material_names, truth.fractions, strict=True):
    inside = pure_voxels(fraction, 65535)
    if name.startswith("iodine") or name == "water":
        values = iodine[inside] / per_mg_ml
        filled.append(float(name.partition("_")[2] or 0))
        found.append(float(values.mean()))
        print(
            f"{name:<10} {filled[-1]:5.1f} mg/ml filled in, {found[-1]:6.2f} found, {values.std():.2f} between voxels"
        )
slope, offset = np.polyfit(filled, found, 1)
print(f"found = {slope:.3f} x filled {offset:+.2f} mg/ml")
dataset.close()
