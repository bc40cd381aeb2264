"""Standard deviations that `recon uncertainty` states, against those of fits of scans with other noise.

    python -m benchmarks.reconstruction.uncertainty [--scans N] [--replicates N] [--threads N] [SCENE ...]

A scene of `scene_kinds.yaml`, or `kedge-small`, is scanned with many noise seeds, and each scan is fitted: the standard
deviation of a voxel between these fits is the true one. One of the fits then states its own from replicates. Groups of
voxels are those that one material fills (inside), and all other ones within two voxels of an interface. A row holds,
for a basis and a group, the root mean square of the true and of the stated standard deviation [1/mm] and their ratio,
the root mean square of the error that all fits have in common, and how often the error of the fit is within two of its
stated standard deviations. Rows of materials hold the standard deviation of the mean over all voxels that it fills.

Rows take the place of those in `results/uncertainty.txt`.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np
import yaml
from scipy.ndimage import binary_dilation

from benchmarks.reconstruction.scene_kinds import SCENES, scanned
from benchmarks.result_rows import store
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.runtime.stopwatch import Stopwatch
from recon.evaluation.metrics import pure_voxels
from recon.evaluation.scoring import FULL_FRACTION
from recon.gaussians.recipe import FAST
from recon.runs.interfaces import Unwatched
from recon.runs.run import run
from recon.runs.run_gaussians import GaussianRun
from recon.runs.write_run import RunFolder
from recon.uncertainty.estimate import Uncertainty, estimate
from spectra.threads import set_threads, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "uncertainty.txt"
NAMED = 48  # characters of a row for its scene, basis and group
HEADER = f"{'scene':<14}{'basis':<16}{'group':<18}{'true':>10}{'stated':>10}{'ratio':>7}{'common':>10}{'within 2':>10}"
QUIET = Unwatched()


def main() -> None:
    changes = {"kedge-small": {}} | yaml.safe_load(SCENES.read_text(encoding="utf-8"))
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=["kedge-small", "vessels"], metavar="SCENE", help="its name")
    parser.add_argument("--scans", type=int, default=20, help="with noise of their own")
    parser.add_argument("--replicates", type=int, default=8)
    parser.add_argument("--threads", type=int, help="default: all")
    asked = parser.parse_args()
    set_threads(asked.threads)
    print(HEADER)
    for scene in asked.scenes:
        with tempfile.TemporaryDirectory() as folder:
            for row in rows_of(scene, changes[scene], asked, Path(folder)):
                store(TABLE, [HEADER], row, NAMED)
                print(row, flush=True)


@without_other_pools()
def rows_of(scene: str, changes: dict, asked: argparse.Namespace, folder: Path) -> list[str]:
    """Measure one scene."""
    fits = []
    for seed in range(asked.scans):
        with scanned(scene, changes, seed, folder / "scan.h5") as dataset:
            if seed == 0:
                truth = read_truth(dataset.path)
                with RunFolder(folder / "run", overwrite=False) as part:
                    run(dataset, part, GaussianRun(FAST), False, QUIET)
                stated = estimate(folder / "run", dataset, asked.replicates, 0, QUIET)
            names = stated.replicates.basis_names
            method = GaussianRun(FAST, len(names))
            fits.append(method.reconstruct(dataset, None, Stopwatch(), QUIET).model.volume(dataset.grid))
    assert truth is not None
    return _rows(scene, np.array(fits), truth, stated)


def _rows(scene: str, fits: np.ndarray, truth: Truth, stated: Uncertainty) -> list[str]:
    """Compare the standard deviations, and the errors with them."""
    true_deviation, common = fits.std(axis=0, ddof=1), fits.mean(axis=0) - truth.volumes
    deviation, error = stated.spread.deviation, fits[0] - truth.volumes
    pure = [pure_voxels(fraction, FULL_FRACTION) for fraction in truth.fractions]
    occupied = binary_dilation((truth.volumes > 0).any(axis=0), iterations=2)
    inside = np.any(pure, axis=0) & (truth.volumes > 0).any(axis=0)
    groups = {"inside": inside, "near interfaces": occupied & ~np.any(pure, axis=0)}
    rows = []
    for basis, name in enumerate(stated.replicates.basis_names):
        for group, voxels in groups.items():
            true, told = (_rms(values[basis][voxels]) for values in (true_deviation, deviation))
            within = np.mean(np.abs(error[basis][voxels]) < 2 * deviation[basis][voxels])
            rows.append(_row((scene, name, group), true, told, _rms(common[basis][voxels]), within))
    for material, voxels in zip(truth.material_names, pure, strict=True):
        if voxels.sum() < 50 or not (truth.volumes[:, voxels] > 0).any():
            continue
        told = stated.replicates.region(voxels).deviation
        means = fits[..., voxels].mean(axis=-1)
        off = means.mean(axis=0) - truth.volumes[:, voxels].mean(axis=-1)
        wrong = np.abs(means[0] - truth.volumes[:, voxels].mean(axis=-1))
        for basis, name in enumerate(stated.replicates.basis_names):
            true = means[:, basis].std(ddof=1)
            within = float(wrong[basis] < 2 * told[basis])
            rows.append(_row((scene, name, f"mean {material}"), true, told[basis], abs(off[basis]), within))
    return rows


def _row(named: tuple[str, str, str], true: float, told: float, common: float, within: float) -> str:
    scene, basis, group = named
    left = f"{scene:<14}{basis:<16}{group:<18}"
    return f"{left}{true:>10.2e}{told:>10.2e}{told / true:>7.2f}{common:>10.1e}{100 * within:>8.0f} %"


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values, dtype=np.float64))))


if __name__ == "__main__":
    main()
