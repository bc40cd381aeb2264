"""
A scan, a fit, and a page about it
==================================

Three calls: ``phantomgen.make`` simulates a scan whose truth is known, ``recon.fit`` reconstructs it from the counts
alone, and ``fit.save`` writes a run folder that every command reads. Run it as one of::

    python examples/plot_first_fit.py           # 64^3 voxels, about a minute
    python examples/plot_first_fit.py --quick   # 24^3 voxels, seconds: coarse, to see that everything works
"""

# sphinx_gallery_thumbnail_path = 'images/first-scan/axial.png'

import sys
from pathlib import Path

import phantomgen
import recon
from phantomgen.display.html import write_page
from recon.gaussians.recipe import Stage
from recon.output.report.page import run_report
from recon.runs.write_run import score_table

QUICK = "--quick" in sys.argv[1:]
FOLDER = Path("first-fit")
FOLDER.mkdir(exist_ok=True)

# %%
# The scene
# ---------
#
# A preset: a cylinder of soft tissue with bone and two concentrations of a K-edge material. Any number of it can be
# overridden; here everything is made smaller for a first look.

SMALL = ["geometry.views=15", "geometry.test_views=2", "panel={rows: 48, columns: 48, pitch: 4.27}", "volume.voxels=24"]
scan = phantomgen.load("kedge-small", SMALL if QUICK else [])
print(scan)

# %%
# The scan
# --------
#
# What comes back is the open dataset. ``counts`` stays in the file until it is indexed; ``line_integrals`` are the
# logarithms that classical methods begin with.

dataset = phantomgen.make(scan, FOLDER / "scan.h5", overwrite=True)
print(dataset)
print("counts of view 3:", dataset.counts[3].shape, "largest log projection:", dataset.line_integrals(3).max())

# %%
# The fit
# -------
#
# A callback is told after every step how well the model explains the counts; one that returns True would end the fit.

deviances = []
recipe = recon.Recipe(stages=(Stage(pixel=1.0, sweeps=20.0),)) if QUICK else "fast"
fit = recon.fit(dataset, recipe, callbacks=[lambda progress: deviances.append(progress.deviance)])
print(fit)
print(f"deviance {deviances[0]:.1f} at first, {deviances[-1]:.2f} at last; 1 is what noise alone would leave")

# %%
# What it knows
# -------------
#
# Volumes on any grid, and what it expects to see from anywhere.

fine = phantomgen.Grid.cube(2 * scan.grid.shape[0], 128.0)
print("volumes on a finer grid:", fit.volume(fine).shape)
print("counts from view 0:", fit.render(dataset.geometry[[0]]).counts.shape)

# %%
# How good it is
# --------------
#
# Only now the truth is opened. The page has the figures that belong to these numbers.

print(score_table(fit.score()))
run = fit.save(FOLDER / "run", overwrite=True)
write_page(run_report([run], dataset.path), FOLDER / "report.html")
dataset.close()
print(f"Wrote {FOLDER / 'report.html'}")
