"""What each part of a fit is worth: one change at a time, error and processor time.

    python -m benchmarks.reconstruction.ablation [z_aligned | metal | implant | pin] [WORD ...]

Fits of Gaussians without planes to `development.yaml`, the scene on which their recipes were chosen, or to one of its
siblings, `development_z_aligned.yaml` and so on; rows whose name is one of the words, or has it after the recipe's
name; all where there are none. Scores are PSNR [dB] of the basis volumes; times are processor time of both threads
from reading to the last step, so that they do not depend on what else the machine does. Rows take the place of those
in `results/ablation.txt`, `results/ablation_z_aligned.txt` and so on.
"""

import platform
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import torch

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from recon.evaluation.scoring import psnr_of_bases
from recon.gaussians.fisher import coefficient_curvature
from recon.gaussians.recipe import PLAIN_BEST, PLAIN_FAST, Recipe, Stage
from recon.gaussians.reconstruct import reconstruct
from spectra.threads import thread_count

FOLDER = Path(__file__).parents[1]
OTHERS = (
    "z_aligned",
    "metal",
    "implant",
    "pin",
)  # flat sides on faces of voxels; thin and thick metal; metal in tissue
NAMED = 70  # characters of a row for its change
HEADER = f"{'change':<70}PE     Compton  K edge  CPU s  Gaussians"


@dataclass(frozen=True)
class Change:
    """A fit that differs from another in one thing.

    Parameters
    ----------
    name : what differs
    recipe : how it is fitted
    patches : constants and functions that are replaced, by where they are
    """

    name: str
    recipe: Recipe
    patches: tuple[tuple[str, Any], ...] = ()


def fast(name: str, *patches: tuple[str, Any], **changes: Any) -> Change:
    return Change(f"fast, {name}", replace(PLAIN_FAST, **changes), patches)


def best(name: str, *patches: tuple[str, Any], **changes: Any) -> Change:
    return Change(f"best, {name}", replace(PLAIN_BEST, **changes), patches)


FIXED_GEOMETRY = {"centre_rate": 1e-9, "shape_rate": 1e-9}
FROM_RAYS = {"prior": 0.0, "centre_rate": 0.06, "shape_rate": 0.015}
FISHER_METRIC = ("recon.gaussians.initial.first_guess.metric_of", lambda volumes, fisher, settings: fisher)
BINNED_BY_SUMS = ("recon.data.measurements.excess_of_blocks", lambda counts, air, factor: 0.0)
UNCORRECTED = ("recon.data.measurements.excess_of_pixels", lambda counts, air: 0.0)
OWN_WEIGHTS = ("recon.data.measurements.neighbourhood_weights", lambda counts, air: 1.0)
EXACT_CORRECTIONS = ("recon.data.measurements.correction_weights", lambda counts, air, dispersion: 1.0)
EQUAL_STEPS = ("recon.voxel.iterative.likelihood.relative_density", lambda volumes: np.ones_like(volumes[0]))
EQUAL_PRIOR_AT_METAL = ("recon.gaussians.voxel_prior.over_metal", lambda volumes: np.ones_like(volumes[0]))
EQUAL_TV_WEIGHTS = (
    "recon.voxel.iterative.one_step._statistical_weights",
    lambda curvatures, density: np.ones_like(density),
)
HIGH_CURVATURE_FLOOR = ("recon.voxel.iterative.one_step.CURVATURE_FLOOR", 1e-3)
NO_MEANS_IN_METAL = ("recon.voxel.iterative.one_step.means_in_metal", lambda volumes: volumes)
EMPTY_BELOW_DENSEST = ("recon.data.volume_edges.LARGEST", np.inf)
DIAGONAL_CURVATURE = (
    "recon.gaussians.objective.coefficient_curvature",
    lambda *scene: torch.diag_embed(torch.diagonal(coefficient_curvature(*scene), dim1=1, dim2=2)),
)
UNSHARPENED = ("recon.voxel.iterative.one_step.sharpened", lambda volumes: volumes)

CHANGES = (
    Change("fast", PLAIN_FAST),
    fast("from decomposed rays and FDK, no prior, 3 sweeps", **FROM_RAYS, stages=(Stage(0.5, 3.0),)),
    fast("coarse voxels not sharpened", UNSHARPENED),
    fast("pixels binned by sums, not by geometric means", BINNED_BY_SUMS),
    fast("no partial-volume correction of single pixels", UNCORRECTED),
    fast("each ray weighted by its own counts", OWN_WEIGHTS),
    fast("partial-volume corrections treated as exact", EXACT_CORRECTIONS),
    fast("dense voxels take the same steps as others", EQUAL_STEPS),
    fast("total variation with equal weight everywhere", EQUAL_TV_WEIGHTS),
    fast("curvature floor of a thousandth for all voxels", HIGH_CURVATURE_FLOOR),
    fast("empty means below a tenth of the densest voxels", EMPTY_BELOW_DENSEST),
    fast("voxel values in metal not converted to means", NO_MEANS_IN_METAL),
    fast("fit to voxels weighted by the Fisher information of the rays", FISHER_METRIC),
    fast("Gaussians not fitted to the voxels first", approximation=1),
    fast("Gaussians fitted to the voxels only, not to the counts", stages=(Stage(0.5, 1e-9),)),
    fast("no prior after the start", prior=1e-9),
    fast("prior as strong along edges", steps_along_edges=1e9),
    fast("prior a tenth as strong along edges", steps_along_edges=1.8),
    fast("pixels summed to the size of voxels", stages=(Stage(1.0, 1.0),)),
    fast("half the rates of the geometry, falling to 0.3", centre_rate=0.01, shape_rate=0.0025, final_rate=0.3),
    fast("weights of pure Poisson noise", dispersion=0.0),
    fast("coefficients only, geometry fixed", **FIXED_GEOMETRY),
    fast("coefficients without momentum", momentum=0.0),
    fast("curvature without terms between bases", DIAGONAL_CURVATURE),
    fast("half as many evaluations of the fit to voxels", approximation=30),
    fast("2 views per step", views_per_step=2),
    fast("fewer Gaussians, spacing 1.2", spacing=1.2),
    Change("best", PLAIN_BEST),
    best("fit to voxels weighted by the Fisher information of the rays", FISHER_METRIC),
    best("no warm-up of the geometry steps", warm_up=0.0),
    best("2 views per step", views_per_step=2),
    best("3 sweeps", stages=(Stage(0.5, 3.0),)),
    best("fewer Gaussians, spacing 1.2", spacing=1.2),
    best("prior three times as strong along edges", steps_along_edges=54.0),
    best("voxel values in metal not converted to means", NO_MEANS_IN_METAL),
    best("prior as strong at metal as along other edges", EQUAL_PRIOR_AT_METAL),
)


@contextmanager
def patched(patches: tuple[tuple[str, Any], ...]) -> Iterator[None]:
    """With the first patch of `patches` and all others."""
    if not patches:
        yield
        return
    with patch(*patches[0]), patched(patches[1:]):
        yield


def row_of(change: Change, dataset: Dataset) -> str:
    """One line of the results."""
    with patched(change.patches):
        began = time.process_time()
        gaussians = reconstruct(dataset, change.recipe).gaussians
        seconds = time.process_time() - began
    truth = read_truth(dataset.path)
    assert truth is not None
    scores = "  ".join(f"{score:5.2f}" for score in psnr_of_bases(truth, gaussians).values())
    return f"{change.name:<70}{scores}  {seconds:6.1f}  {len(gaussians):8d}"


def main(words: list[str]) -> None:
    suffix = f"_{words[0]}" if words and words[0] in OTHERS else ""
    words = words[1:] if suffix else words
    scan = phantomgen.load(FOLDER / "scenes" / f"development{suffix}.yaml")
    table = FOLDER / "results" / f"ablation{suffix}.txt"
    with (
        tempfile.TemporaryDirectory() as folder,
        phantomgen.make(scan, out=Path(folder) / "scan.h5") as dataset,
    ):
        for change in CHANGES:
            if not words or change.name in words or any(word in change.name.partition(", ")[2] for word in words):
                row = row_of(change, dataset)
                store(table, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
                print(row, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
