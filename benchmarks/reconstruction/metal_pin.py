"""What a steel pin does to contrast agents beside it, with and without the prior that metal holds none.

    python -m benchmarks.reconstruction.metal_pin [fast | best]

Fits of `metal_pin.yaml` with the prior off and on, and of the same scan with acrylic in place of the pin. PSNR [dB] of
every basis over the whole volume and without the metal, means inside the pin, and mean error and standard deviation in
three regions: the vial of iodine; acrylic around it; acrylic between it and the pin. Regions are pure in the truth, a
voxel away from other materials, and the same in all fits. Values are 1e-3 per mm. Times are processor time from reading
to the last step.
"""

import platform
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_dilation, binary_erosion

import phantomgen
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.scene.scan import Scan
from recon.evaluation.metrics import psnr
from recon.evaluation.scoring import FULL_FRACTION, score_test_views
from recon.gaussians.recipe import RECIPES
from recon.gaussians.reconstruct import reconstruct
from spectra.basis.basis import pretty
from spectra.threads import thread_count

SCENE = Path(__file__).parents[1] / "scenes" / "metal_pin.yaml"
RESULTS = Path(__file__).parents[1] / "results" / "metal_pin.txt"
FITS = ("no pin", "prior off", "prior on")
BESIDE = 1  # voxels around the metal that count as metal, as they hold some of it
RING = 3.0  # mm of acrylic around the vial
LINE = 2.0  # mm from the line between pin and vial


@dataclass(frozen=True, eq=False)
class Found:
    """A fit.

    Parameters
    ----------
    volumes : of the bases [1/mm]
    truth : of its scan
    seconds : processor time
    chi_square : of test views, all rays and off edges, in the worst channel
    """

    volumes: Float[np.ndarray, "basis z y x"]
    truth: Truth
    seconds: float
    chi_square: tuple[float, float]


def fitted(scan: Scan, path: Path, recipe: str, prior: bool) -> Found:
    """A fit, whose scan is made where there is none."""
    dataset = phantomgen.open_dataset(path) if path.exists() else phantomgen.make(scan, out=path)
    off = (
        patch("recon.voxel.iterative.one_step.AGENT_PRIOR", 0.0),
        patch("recon.gaussians.voxel_prior.VoxelPrior.held_coefficients", lambda prior, gaussians: None),
    )
    with dataset:
        began = time.process_time()
        if prior:
            model = reconstruct(dataset, RECIPES[recipe]).gaussians
        else:
            with off[0], off[1]:
                model = reconstruct(dataset, RECIPES[recipe]).gaussians
        seconds = time.process_time() - began
        channels = score_test_views(dataset, model).values()
        truth = read_truth(path)
        assert truth is not None
        worst = tuple(max(c[f"chi_square_{rays}"] for c in channels) for rays in ("all", "away"))
        return Found(model.volume(truth.grid), truth, seconds, worst)  # type: ignore[arg-type]


def filled(truth: Truth, material: str) -> Bool[np.ndarray, "z y x"]:
    """Voxels that hold any of a material."""
    return np.asarray(truth.fractions[truth.material_names.index(material)] > 0)


def pure(truth: Truth, material: str) -> Bool[np.ndarray, "z y x"]:
    """Voxels of a material alone, whose neighbours are so, too."""
    full = truth.fractions[truth.material_names.index(material)] == FULL_FRACTION
    return np.asarray(binary_erosion(full), bool)


def grown(where: Bool[np.ndarray, "z y x"], voxels: int) -> Bool[np.ndarray, "z y x"]:
    """The same voxels and those so many steps away."""
    return np.asarray(binary_dilation(where, iterations=voxels), bool)


def regions(truth: Truth) -> dict[str, Bool[np.ndarray, "z y x"]]:
    """Voxels whose values are looked at, by their name."""
    vial, acrylic, spacing = pure(truth, "iodine"), pure(truth, "acrylic"), truth.grid.spacing
    inside = np.asarray(vial.any(axis=(1, 2)))[:, None, None]
    y, x = np.meshgrid(truth.grid.axis("y"), truth.grid.axis("x"), indexing="ij")
    ends = [[float(values[some.any(axis=0)].mean()) for values in (y, x)] for some in (filled(truth, "steel"), vial)]
    pin, middle = np.array(ends)
    along = (middle - pin) / np.linalg.norm(middle - pin)
    away = np.abs((y - pin[0]) * along[1] - (x - pin[1]) * along[0])
    part = ((y - pin[0]) * along[0] + (x - pin[1]) * along[1]) / np.linalg.norm(middle - pin)
    beside = ~grown(filled(truth, "steel"), 1 + BESIDE)
    around = grown(filled(truth, "iodine"), round(RING / spacing[1]))
    return {
        "iodine vial": vial,
        "acrylic around it": acrylic & around & inside & beside,
        "acrylic between": acrylic & inside & beside & (away < LINE) & (part > 0) & (part < 1),
    }


def rows(found: dict[str, Found]) -> list[str]:
    """Lines of the tables."""
    scene = found["prior on"].truth
    metal = filled(scene, "steel")
    without = ~grown(metal, BESIDE)
    core = scene.fractions[scene.material_names.index("steel")] > FULL_FRACTION / 2
    names = "".join(f"{pretty(name)[:13]:>15}" for name in scene.basis_names)
    out = [f"{'PSNR [dB]':<34}{names}   chi-square all, off edges    CPU s"]
    for name, fit in found.items():
        costs = f"{fit.chi_square[0]:19.2f}{fit.chi_square[1]:10.2f}{fit.seconds:9.0f}"
        out.append(f"{name + ', whole':<34}{scores(fit, np.ones_like(without))}{costs}")
        out.append(f"{name + ', without metal':<34}{scores(fit, without)}")
    out += ["", f"{f'mean of {core.sum()} voxels, half steel':<34}{names}   [1e-3/mm]"]
    for name, fit in (("truth", None), *found.items()):
        values = scene.volumes if fit is None else fit.volumes
        out.append(f"{name + ', in the pin':<34}" + "".join(f"{1e3 * v:15.2f}" for v in values[:, core].mean(axis=1)))
    for region, inside in regions(scene).items():
        out += ["", f"{f'{region}, {inside.sum()} voxels':<34}{names}   mean error / standard deviation [1e-3/mm]"]
        for name, fit in found.items():
            error = fit.volumes[:, inside] - fit.truth.volumes[:, inside]
            spread = zip(1e3 * error.mean(axis=1), 1e3 * error.std(axis=1), strict=True)
            out.append(f"{name + ', ' + region:<34}" + "".join(f"{f'{b:.3f} / {s:.3f}':>15}" for b, s in spread))
    return out


def scores(found: Found, where: Bool[np.ndarray, "z y x"]) -> str:
    """PSNR of each basis, whose peak is the largest true value there."""
    pairs = zip(found.volumes, found.truth.volumes, strict=True)
    values = [psnr(float(t[where].max()), float(np.mean((v[where] - t[where]) ** 2))) for v, t in pairs]
    return "".join(f"{value:15.1f}" for value in values)


def main(recipe: str) -> None:
    """Make the scans, fit them, write the tables."""
    scan = phantomgen.load(SCENE)
    changed = f"objects.{len(scan.scene.objects) - 1}.material=acrylic"
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / name for name in ("none.h5", "pin.h5", "pin.h5")]
        scans = (phantomgen.load(SCENE, [changed]), scan, scan)
        found = {
            name: fitted(some, path, recipe, name != "prior off")
            for name, some, path in zip(FITS, scans, paths, strict=True)
        }
    out = [f"{platform.machine()}, {thread_count()} threads, {recipe}", *rows(found)]
    print("\n".join(out), flush=True)
    RESULTS.write_text("\n".join(out) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(*(sys.argv[1:] or ["fast"]))
