"""Scans with one channel: beam hardening and metal by seven methods.

    python -m benchmarks.reconstruction.one_energy [--threads N] [--methods NAME,NAME] [SCENE ...]

Scenes: a cylinder of water, `metal-hip` and `kedge` with a single threshold, and a head with dental metal
(`benchmarks/scenes/dental_head.yaml`). Methods: filtered back-projection without a correction (`fdk`, in units of the
mean attenuation of water), with a water correction (`fdk-water`), with normalised metal artefact reduction (`nmar`), a
network behind a polychromatic model (`polyner`), published Gaussians with one material each behind the same model
(`gaussian-poly`), one-step voxels along the standard curve of materials (`curve`), as
`recon fit --bases curve --method one-step` has it, and the Gaussians of `--method gaussian` (`gaussian`). Either with
further materials on the curve: `curve+Au`.

A row states the PSNR [dB] of the attenuation at 70 keV over all voxels; the same where the true attenuation is below
0.1 per mm, which leaves out metal, with the attenuation of bone (0.05 per mm) as the peak; the root mean square error
of matter there [HU]; the same more than three voxels from metal; cupping of the cylinder of water [%], the mean below
its surface less that in its middle over the whole mean; and processor seconds. Rows take the place of those in
`results/one_energy.txt`.
"""

import argparse
import platform
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.ndimage import binary_dilation

import phantomgen
from benchmarks.result_rows import store
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.geometry.voxel_grid import Grid
from recon.data.measurements import Measurements, read_measurements
from recon.gaussians.recipe import FAST, Recipe
from recon.gaussians.reconstruct import reconstruct
from recon.kedge.basis_names import OnCurve, with_named
from recon.published_methods.neural.polyner import Polyner
from recon.published_methods.splatting.polychromatic import GaussianPoly
from recon.voxel.image_domain import log_projections
from recon.voxel.iterative.one_step import OneStep
from recon.voxel.one_channel.nmar import Nmar
from recon.voxel.one_channel.water_correction import FdkWater, filtered, lines_of_water
from spectra.materials.material_curve import ENERGY, MaterialCurve
from spectra.threads import set_threads, thread_count, without_other_pools

TABLE = Path(__file__).parents[1] / "results" / "one_energy.txt"
HEAD = Path(__file__).parents[1] / "scenes" / "dental_head.yaml"
WATER_OBJECT = "objects=[{type: cylinder, material: water, radius: 60, length: 100}]"
SCENES: dict[str, tuple[str, list[str]]] = {  # scene or preset, and changes
    "water": ("metal-hip", ["detector.thresholds=[25]", "materials={water: {composition: water}}", WATER_OBJECT]),
    "metal-hip": ("metal-hip", ["detector.thresholds=[25]"]),
    "dental-head": (str(HEAD), []),
    "kedge": ("kedge", ["detector.thresholds=[20]"]),
}
METHODS = ("fdk", "fdk-water", "nmar", "polyner", "gaussian-poly", "curve", "gaussian")
NAMED = 28  # characters of a row for its scene and method
HEADER = (
    f"{'scene':<14}{'method':<14}{'all [dB]':>10}{'no metal':>10}{'rms [HU]':>10}{'apart [HU]':>12}{'cupping [%]':>13}"
    f"{'CPU s':>8}"
)
METAL, BONE = 0.1, 0.05  # 1/mm at 70 keV
RADIUS = 60.0  # mm, of the cylinder of water


def mono_of(
    method: str, measured: Measurements, grid: Grid, curve: MaterialCurve, at: Float[np.ndarray, " basis"]
) -> Float[np.ndarray, "z y x"]:
    """Reconstruct the attenuation at the energy of the curve [1/mm]."""
    if method == "fdk":
        lines, data = lines_of_water(measured, grid, curve)
        logs = log_projections(data)[0]
        thin = (lines > 0.01) & (lines < 0.2)  # the slope of logarithms at little water
        return filtered((logs * np.median(lines[thin] / logs[thin])).astype(np.float32), data, grid)
    if method == "curve":
        prepared, _ = measured.without_partial_volume().compressed(Recipe().node_tolerance)
        return np.einsum("m,mzyx->zyx", at, OneStep(curve=curve).reconstruct_counts(prepared, grid))
    kinds = {"fdk-water": FdkWater, "nmar": Nmar, "polyner": Polyner, "gaussian-poly": GaussianPoly}
    return np.einsum("m,mzyx->zyx", at, kinds[method](curve=curve).reconstruct_counts(measured, grid))


def cupping(volume: Float[np.ndarray, "z y x"], grid: Grid) -> float:
    """Mean below the surface of a cylinder less that in its middle, over the whole mean [%]."""
    y, x = np.meshgrid(grid.axis("y"), grid.axis("x"), indexing="ij")
    away = np.hypot(x, y) / RADIUS
    middle = volume[len(volume) // 2 - 2 : len(volume) // 2 + 2].mean(axis=0)
    outer, inner = middle[(away > 0.8) & (away < 0.92)].mean(), middle[away < 0.3].mean()
    return float(100 * (outer - inner) / middle[away < 0.92].mean())


def row_of(scene: str, name: str, dataset: Dataset) -> str:
    """One line of the results."""
    truth = read_truth(dataset.path)
    assert truth is not None
    true = np.tensordot(dataset.spectra.basis.evaluate(np.array([ENERGY]))[:, 0], truth.volumes, axes=1)
    method, *more = name.split("+")
    asked = OnCurve((*OnCurve().materials, *more))
    smooth, _ = with_named(dataset, asked)
    curve = asked.curve(smooth)
    at = smooth.spectra.basis.evaluate(np.array([ENERGY]))[:, 0]
    measured = read_measurements(smooth, smooth.splits["train"], separable=False)
    began = time.process_time()
    if method == "gaussian":
        fitted = reconstruct(smooth, replace(FAST, curve=curve))
        assert fitted.volumes is not None
        found = np.einsum("m,mzyx->zyx", at, fitted.volumes)
    else:
        found = mono_of(method, measured, dataset.grid, curve, at)
    seconds = time.process_time() - began
    error, soft = (found - true) ** 2, true < METAL
    whole = 10 * np.log10(true.max() ** 2 / error.mean())
    without = 10 * np.log10(BONE**2 / error[soft].mean())
    apart = ~binary_dilation(~soft, iterations=3)
    unit = curve.attenuations[curve.materials.index("water")] / 1000  # 1/mm, of a Hounsfield unit
    edges, away = (np.sqrt(error[part & (true > 0)].mean()) / unit for part in (soft, apart))
    cup = f"{cupping(found, dataset.grid):>13.2f}" if scene == "water" else f"{'-':>13}"
    return f"{scene:<14}{name:<14}{whole:>10.2f}{without:>10.2f}{edges:>10.1f}{away:>12.1f}{cup}{seconds:>8.1f}"


@without_other_pools()
def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("scenes", nargs="*", default=list(SCENES), metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--methods", default=",".join(METHODS), help="default: %(default)s")
    parser.add_argument("--threads", type=int, help="default: all")
    asked = parser.parse_args()
    if unknown := set(asked.scenes) - set(SCENES):
        parser.error(f"no scene {', '.join(sorted(unknown))}; there are {', '.join(SCENES)}")
    methods = asked.methods.split(",")
    if unknown := {method.split("+")[0] for method in methods} - set(METHODS):
        parser.error(f"no method {', '.join(sorted(unknown))}; there are {', '.join(METHODS)}")
    set_threads(asked.threads)
    print(HEADER)
    with tempfile.TemporaryDirectory() as folder:
        for scene in asked.scenes:
            source, changes = SCENES[scene]
            path = Path(folder) / f"{scene}.h5"
            with phantomgen.make(phantomgen.load(source, changes), out=path, overwrite=True) as dataset:
                for method in methods:
                    row = row_of(scene, method, dataset)
                    store(TABLE, [f"{platform.machine()}, {thread_count()} threads", HEADER], row, NAMED)
                    print(row, flush=True)


if __name__ == "__main__":
    main()
