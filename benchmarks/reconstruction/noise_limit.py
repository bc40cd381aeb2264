"""Noise in flat regions over the least that the counts allow.

    python -m benchmarks.reconstruction.noise_limit

Two scans of `noise_limit.yaml` that differ in their noise alone. Half the difference of two reconstructions is noise;
the mean of both less the truth, its own noise subtracted, is bias. Both are averaged over balls of some voxels across
that lie in one material, two voxels from its surface at least, and divided by the Cramer-Rao bound of the mean over
such a ball when all voxels and bases are unknown (`recon.evaluation.voxel_cramer_rao`); root mean square over the
balls. Below 1 is what a method has assumed.
"""

import itertools
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import binary_erosion

import phantomgen
from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth, read_truth
from recon.data.measurements import Measurements, read_measurements
from recon.evaluation.scoring import FULL_FRACTION
from recon.evaluation.voxel_cramer_rao import VoxelInformation, least_variances
from recon.gaussians.recipe import PLAIN_BEST, Recipe, Stage
from recon.gaussians.reconstruct import reconstruct
from recon.voxel.iterative.one_step import OneStep
from spectra.threads import thread_count, without_other_pools

SCENE = Path(__file__).parents[1] / "scenes" / "noise_limit.yaml"
RESULTS = Path(__file__).parents[1] / "results" / "noise_limit.txt"
MATERIAL = "contrast"
ACROSS = (3, 5, 8)  # voxels
APART = 2  # voxels between a ball and the material's surface
ITERATIONS = 30
NODE_TOLERANCE = 1e-3
SEEDS = (1, 2)


def without_prior(sweeps: float) -> Recipe:
    """The fit that follows the likelihood alone, with the larger rates that a start from decomposed rays wants."""
    return Recipe(prior=0.0, centre_rate=0.06, shape_rate=0.015, stages=(Stage(1.0, sweeps),))


def voxels(strength: float, passes: int) -> Callable[[Dataset], np.ndarray]:
    method = replace(OneStep(), strength=strength, levels=((4, 8), (2, 8), (1, passes)))
    return lambda dataset: method.reconstruct_counts(measured_of(dataset), dataset.grid)


def gaussians(recipe: Recipe) -> Callable[[Dataset], np.ndarray]:
    return lambda dataset: reconstruct(dataset, recipe).gaussians.volume(dataset.grid)


METHODS = {
    "Gaussians without prior, 5 sweeps": gaussians(without_prior(5)),
    "Gaussians without prior, 20 sweeps": gaussians(without_prior(20)),
    "Gaussians": gaussians(PLAIN_BEST),
    "one-step voxels without prior": voxels(0.0, 16),
    "one-step voxels": voxels(OneStep().strength, 16),
}


def measured_of(dataset: Dataset) -> Measurements:
    return read_measurements(dataset, dataset.splits["train"]).without_partial_volume().compressed(NODE_TOLERANCE)[0]


def ball(across: int) -> Bool[np.ndarray, "z y x"]:
    """Voxels whose centres lie in a ball."""
    place = np.arange(across) - (across - 1) / 2
    square = sum(p**2 for p in np.meshgrid(place, place, place, indexing="ij"))
    return np.asarray(square <= (across / 2) ** 2)


def balls(truth: Truth, across: int) -> Float[np.ndarray, "ball z y x"]:
    """Weights of the mean over each of the balls that fit, in a lattice as wide as they are."""
    pure = truth.fractions[truth.material_names.index(MATERIAL)] == FULL_FRACTION
    pure = binary_erosion(pure, iterations=APART)
    one, shape, found = ball(across), pure.shape, []
    starts = [range(n // 2 % across, n - across + 1, across) for n in shape]
    for corner in itertools.product(*starts):
        some = tuple(slice(c, c + across) for c in corner)
        if pure[some][one].all():
            weights = np.zeros(shape, np.float32)
            weights[some] = one / one.sum()
            found.append(weights)
    return np.stack(found)


def bounds(dataset: Dataset, truth: Truth, regions: dict[int, np.ndarray]) -> dict[int, Float[np.ndarray, " basis"]]:
    """Root mean square of the least standard deviations of the means over the balls [1/mm].

    A sum of the balls' weights with random signs has, on average over the signs, the variances of all of them.
    """
    rng = np.random.default_rng(0)
    signed = [np.tensordot(rng.choice([-1.0, 1.0], len(r)), r, axes=1) / np.sqrt(len(r)) for r in regions.values()]
    information = VoxelInformation.of(measured_of(dataset), truth.volumes, dataset.grid)
    variances = least_variances(information, np.stack(signed), ITERATIONS)
    return dict(zip(regions, np.sqrt(variances), strict=True))


def means(volumes: np.ndarray, regions: np.ndarray) -> Float[np.ndarray, "ball basis"]:
    return np.einsum("bzyx,mzyx->bm", regions, volumes, optimize=True)


def rows(datasets: list[Dataset], truth: Truth) -> Iterator[str]:
    """Lines of the tables."""
    regions = {across: balls(truth, across) for across in ACROSS}
    begun = time.process_time()
    least = bounds(datasets[0], truth, regions)
    names = "".join(f"{name[:8]:>10s}" for name in truth.basis_names)
    seconds = time.process_time() - begun
    yield f"{'least standard deviation [1e-5/mm]':35s} balls{names}{'':{len(names) + 5}s}{seconds:11.0f}"
    for across, bound in least.items():
        numbers = "".join(f"{1e5 * b:10.2f}" for b in bound)
        yield f"{f'{across} voxels across':36s}{len(regions[across]):5d}{numbers}"
    yield f"\n{'':41s}{'noise over it':>{len(names)}s}{'bias over it':>{len(names) + 5}s}"
    yield f"{'':35s}across{names}     {names}    CPU [s]"
    for name, method in METHODS.items():
        begun = time.process_time()
        found = [method(dataset) for dataset in datasets]
        seconds = (time.process_time() - begun) / len(datasets)
        for across, weights in regions.items():
            a, b = (means(volumes, weights) for volumes in found)
            away = (a + b) / 2 - means(truth.volumes, weights)
            noise = np.sqrt(np.mean((a - b) ** 2, axis=0) / 2)
            bias = np.sqrt(np.maximum(np.mean(away**2, axis=0) - noise**2 / 2, 0))
            numbers = "".join(f"{x:10.2f}" for x in noise / least[across]) + " " * 5
            numbers += "".join(f"{x:10.2f}" for x in bias / least[across])
            yield f"{name:36s}{across:5d}{numbers}{seconds:11.0f}"


@without_other_pools()
def main() -> None:
    out = [f"{platform.machine()}, {thread_count()} threads"]
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{seed}.h5" for seed in SEEDS]
        datasets = [phantomgen.make(SCENE, path, seed=seed) for path, seed in zip(paths, SEEDS, strict=True)]
        for line in rows(datasets, read_truth(paths[0])):
            out.append(line)
            print(line, flush=True)
        for dataset in datasets:
            dataset.close()
    RESULTS.write_text("\n".join(out) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
