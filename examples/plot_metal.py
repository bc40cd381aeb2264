"""
Streaks between two metal rods
==============================

Titanium takes the soft photons out of the beam. Whoever takes the logarithm of counts for a line integral then sees
too little attenuation between two rods: dark streaks. A model of the spectrum knows better. This compares the two on
the same counts. Run it as one of::

    python examples/plot_metal.py           # 64^3 voxels, a minute
    python examples/plot_metal.py --quick   # 48^3 voxels, seconds
"""

# sphinx_gallery_thumbnail_path = 'images/metal-rods.png'

import sys
from pathlib import Path

import numpy as np

import phantomgen
from phantomgen.runtime.stopwatch import Stopwatch
from recon.data.measurements import read_measurements
from recon.output.report.quantities import Maps, slice_figure
from recon.readouts.quantity import in_pieces, quantity
from recon.readouts.readouts import Readouts
from recon.runs.methods import method_named
from recon.runs.run_voxels import reconstruct_volumes

QUICK = "--quick" in sys.argv[1:]
FOLDER = Path("metal-example")
FOLDER.mkdir(exist_ok=True)
SCENE = Path(__file__).with_name("metal.yaml")

SMALL = ["geometry.views=36", "geometry.test_views=0", "panel={rows: 24, columns: 96, pitch: 2.13}", "volume.voxels=48"]
scan = phantomgen.load(SCENE, SMALL if QUICK else [])
dataset = phantomgen.make(scan, FOLDER / "metal.h5", overwrite=True)
print(dataset)

# %%
# How little is left
# ------------------
#
# Counts behind both rods, as part of the open beam: in the lowest channel hardly any.

for name, image in zip(
    dataset.spectra.channels, dataset.line_integrals(len(dataset.splits["train"]) // 4), strict=True
):
    print(f"{name}: {100 * np.exp(-np.nanmax(image)):.2g} % of the photons pass the darkest pixel")

# %%
# Two ways
# --------
#
# ``image``: every channel is reconstructed by filtered back-projection of its logarithms, then decomposed voxel by
# voxel. ``one-step``: all channels at once from the counts, through the spectrum.

measured, _ = read_measurements(dataset, dataset.splits["train"]).compressed(1e-3)


def volumes(name: str, pipeline: str) -> np.ndarray:
    """Basis volumes [1/mm]."""
    stages = Stopwatch(lambda stage: None)
    return reconstruct_volumes(measured, dataset.grid, method_named(name, None), pipeline, stages, lambda _: None)


results = {"image": volumes("fdk", "image"), "one-step": volumes("one-step", "two-step")}

# %%
# What is between the rods
# ------------------------
#
# Water is 0 HU. The strip between the rods says how far a method is off, its spread how much of it is streaks.

truth, spectra = phantomgen.read_truth(dataset.path), dataset.spectra
ct_numbers = quantity(Readouts.of(spectra.basis, spectra.energy, spectra.weights.sum(axis=0)), "hu", 70.0)
true = in_pieces(ct_numbers, truth.volumes)
x, y, z = (dataset.grid.axis(axis) for axis in "xyz")
strip = np.ix_(np.abs(z) < 8, np.abs(y) < 4, np.abs(x) < 8)
errors = {}
for method, result in results.items():
    image = in_pieces(ct_numbers, result)
    errors[method] = float(image[strip].mean())
    print(f"{method:<9} between the rods {image[strip].mean():7.1f} HU, spread {image[strip].std():.1f} HU")
    slice_figure(Maps(ct_numbers, image, true), dataset.grid, FOLDER / f"{method}.png")
    print(FOLDER / f"{method}.png")
dataset.close()
