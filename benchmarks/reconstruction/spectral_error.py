"""What an error of the stated spectrum costs, and what `recon fit --refine` gives back.

    python -m benchmarks.reconstruction.spectral_error [--threads N] [SCENE ...]

Each scan is simulated with the true values and reconstructed by `one-step` with the values that the scene states. True
less stated: voltage -2 kV, filter +0.25 mm of aluminium (10 %), thresholds but the lowest +1, -1, +1, ... keV, or all
of them. Root mean square errors of the basis volumes, in per cent of the largest true value: with the stated spectrum,
with the one refined by rays, and with the one refined by rays and ratios of open-beam counts. Below a row are the
errors that either refinement found. Rows take the place of those in `results/spectral_error.txt`.
"""

import argparse
import platform
import tempfile
from pathlib import Path

import numpy as np

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from recon.calibration.refine import Refinement, refined
from recon.calibration.spectrum_file import sensitivities_of, with_sensitivities
from recon.data.measurements import read_measurements
from recon.gaussians.recipe import Recipe
from recon.runs.methods import method_named
from recon.voxel.method import CountsMethod
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "spectral_error.txt"
SCENES = ("kedge-small", "random")
VOLTAGE, FILTER, THRESHOLD = -2.0, 0.25, 1.0  # true less stated: kV, mm, keV
CASES = {
    "none": (0, 0, 0),
    "all": (1, 1, 1),
    "voltage": (1, 0, 0),
    "filter": (0, 1, 0),
    "thresholds": (0, 0, 1),
}
NAMED = 26  # characters of a row for scene and error
HEADER = f"{'scene, error':<{NAMED}}{'stated':<24}{'refined':<24}{'refined with air':<24}[% per basis]"


def true_scene(scene: str, case: str) -> tuple[list[str], float]:
    """Overrides that make the scan differ from what the scene states, and the stated voltage [kV]."""
    stated = phantomgen.load(scene)
    voltage, thresholds = stated.source.maximum, np.array(stated.detector.thresholds)
    kv, mm, kev = CASES[case]
    signs = np.where(np.arange(len(thresholds)) % 2, 1.0, -1.0)
    signs[0] = 0
    moved = (thresholds + kev * THRESHOLD * signs).tolist()
    return [
        f"source.kvp={voltage + kv * VOLTAGE}",
        f"source.filters.0.thickness={2.5 + mm * FILTER}",
        f"detector.thresholds={moved}",
    ], voltage


def errors_of(dataset: Dataset, truth: Truth) -> str:
    """Error of each basis volume [%]."""
    method = method_named("one-step", None, 0)
    assert isinstance(method, CountsMethod)
    measured = read_measurements(dataset, dataset.splits["train"]).without_partial_volume()
    volumes = method.reconstruct_counts(measured.compressed(Recipe().node_tolerance)[0], dataset.grid)
    pairs = zip(np.asarray(volumes, np.float64), np.asarray(truth.volumes, np.float64), strict=True)
    return "  ".join(f"{100 * np.sqrt(np.mean((v - t) ** 2)) / t.max():5.2f}" for v, t in pairs)


def found_errors(refinement: Refinement) -> str:
    """Errors that a refinement found, with uncertainties."""
    found = refinement.found
    rows = zip(refinement.names, found.values, found.uncertainty, refinement.units, strict=True)
    deviance = f"deviance {refinement.before / refinement.freedom:.3g} -> {found.deviance / refinement.freedom:.3g}"
    return ", ".join([f"{n} {v:+.2f} +- {s:.2f} {u}" for n, v, s, u in rows] + [deviance])


def rows(scene: str, case: str, folder: Path) -> list[str]:
    """Lines of the results for an error."""
    changes, voltage = true_scene(scene, case)
    stated = phantomgen.make(phantomgen.load(scene), out=folder / f"{scene}.h5", overwrite=True)
    known = sensitivities_of(stated.spectra)
    with phantomgen.make(phantomgen.load(scene, changes), out=folder / "true.h5", overwrite=True) as scan:
        truth = read_truth(scan.path)
        assert truth is not None
        wrong = with_sensitivities(scan, known)
        found = [refined(wrong, air=air, voltage=voltage) for air in (False, True)]
        columns = [errors_of(dataset, truth) for dataset in (wrong, *(r.dataset for r in found))]
    stated.close()
    name = f"{scene}, {case}"
    return [
        f"{name:<{NAMED}}" + "".join(f"{column:<24}" for column in columns),
        *(
            f"{f'  {name}{air}':<{NAMED + 10}}{found_errors(r)}"
            for air, r in zip((": rays", ": + air"), found, strict=True)
        ),
    ]


@without_other_pools()
def main() -> None:
    """Measure and store the rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE")
    parser.add_argument("--threads", type=int)
    options = parser.parse_args()
    set_threads(options.threads)
    head = [f"{platform.machine()}, {thread_count()} threads", "", HEADER]
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            for scene in options.scenes if case in ("none", "all") else options.scenes[:1]:
                for row in rows(scene, case, Path(folder)):
                    print(row, flush=True)
                    store(TABLE, head, row, NAMED + 10 if row.startswith(" ") else NAMED)


if __name__ == "__main__":
    main()
