"""Seconds of `recon segment`'s clustering against the number of Gaussians, and how well samples stand for all of them.

    python -m benchmarks.reconstruction.clustering

Models are lattices of overlapping Gaussians with the materials of `kedge` and coefficients with 5 % of noise. Seconds
are CPU seconds of one thread for the whole segmentation, that of the volumes from Gaussians included, and for the
clustering alone. Agreement: the part of samples that have the same cluster when modes come from 10000 samples on
binned seeds, and when they come from all samples, on binned seeds or on every sample.
"""

import time

import numpy as np
import torch
from sklearn.cluster import MeanShift

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians
from recon.readouts.mechanisms import Mechanisms
from recon.segmentation.clustering import BANDWIDTH, SAMPLES, find_modes, nearest_mode, unit_of
from recon.segmentation.features import features_of
from recon.segmentation.result import Options
from recon.segmentation.segment import segment_subject
from recon.segmentation.subject import Subject
from spectra.basis.basis import Basis, BasisFunction
from spectra.threads import set_threads

BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=63.3)))
TISSUE, BONE, HIGH, LOW = (0.0015, 0.0188, 0), (0.0173, 0.032, 0), (0.0067, 0.018, 0.025), (0.0041, 0.0179, 0.0125)
RODS = ((BONE, (-22, 6), 13), (HIGH, (22, -6), 11), (LOW, (0, -28), 9))
SIZE = 100.0  # mm
WIDTH = 0.7  # standard deviation of a Gaussian in steps of the lattice
ENERGY, WEIGHTS = np.linspace(25.0, 120.0, 20), np.ones(20)


def materials_at(points: np.ndarray) -> np.ndarray:
    """Which material is where: 0 air, 1 tissue, 2 to 4 the rods."""
    x, y = points[:, 0], points[:, 1]
    labels = np.where(np.hypot(x, y) < 48, 1, 0)
    for i, (_, (cx, cy), radius) in enumerate(RODS):
        labels[np.hypot(x - cx, y - cy) < radius] = i + 2
    return labels


def model_of(side: int) -> Subject:
    """About side^3 Gaussians, without those of air, and voxels as large as the lattice."""
    step = SIZE / side
    axis = (np.arange(side) - (side - 1) / 2) * step
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    labels = materials_at(points)
    points, labels = points[labels > 0], labels[labels > 0]
    values = np.array([TISSUE, *(rod[0] for rod in RODS)])[labels - 1]
    rng = np.random.default_rng(0)
    values = values * rng.normal(1.0, 0.05, values.shape) / (np.sqrt(2 * np.pi) * WIDTH) ** 3
    count = len(points)
    turn = torch.zeros(count, 4)
    turn[:, 0] = 1
    scales = torch.full((count, 3), float(np.log(WIDTH * step)))
    parts = torch.from_numpy(points).float(), scales, turn, torch.from_numpy(values).float()
    gaussians = Gaussians(*parts, basis_names=BASIS.names)
    grid = Grid.cube(min(side, 128), SIZE)
    return Subject(gaussians.volume(grid), grid, BASIS, ENERGY, WEIGHTS, gaussians)


def samples_of(count: int) -> np.ndarray:
    """Features of places in materials, with 5 % of noise."""
    rng = np.random.default_rng(1)
    labels = materials_at(rng.uniform(-SIZE / 2, SIZE / 2, (2 * count, 3)))
    labels = labels[labels > 0][:count]
    values = np.array([TISSUE, *(rod[0] for rod in RODS)])[labels - 1]
    mechanisms = Mechanisms.of(BASIS, ENERGY, WEIGHTS)
    return features_of(mechanisms, mechanisms((values * rng.normal(1, 0.05, values.shape)).T)).T


def all_seeds(samples: np.ndarray, unit: np.ndarray) -> np.ndarray:
    """Modes of a mean shift that starts at every sample."""
    return MeanShift(bandwidth=BANDWIDTH).fit(samples / unit).cluster_centers_ * unit


def agreement(count: int, most: int, every_seed: bool) -> tuple[float, int, int, float, float]:
    """Part of equal labels, clusters of both ways, CPU seconds of both."""
    samples = samples_of(count)
    unit = unit_of(samples, 0.05 * np.median(samples, axis=0))
    began = time.process_time()
    few = find_modes(samples, unit, most=most)
    middle = time.process_time()
    full = all_seeds(samples, unit) if every_seed else find_modes(samples, unit, most=None)
    ended = time.process_time()
    first, second = nearest_mode(samples, few, unit), nearest_mode(samples, full, unit)
    table = np.zeros((len(few), len(full)), np.int64)
    np.add.at(table, (first, second), 1)
    return table.max(axis=1).sum() / count, len(few), len(full), middle - began, ended - middle


def main() -> None:
    set_threads(1)
    segment_subject(model_of(16), Options())  # compiles the kernels
    print(f"{'Gaussians':>10}{'segmentation':>14}{'clustering':>12}{'materials':>11}   [-, s, s, -]")
    for side in (24, 48, 72, 88, 96):
        subject = model_of(side)
        began = time.process_time()
        found = segment_subject(subject, Options())
        whole = time.process_time() - began
        samples = samples_of(len(subject.gaussians))  # type: ignore[arg-type]
        began = time.process_time()
        unit = unit_of(samples, 0.05 * np.median(samples, axis=0))
        nearest_mode(samples, find_modes(samples, unit), unit)
        alone = time.process_time() - began
        print(f"{len(samples):>10}{whole:>14.2f}{alone:>12.2f}{len(found.clusters):>11}")
    names = (
        f"{'samples':>10}{'taken':>7}{'seeds':>8}{'agreement':>12}{'clusters':>10}{'full':>6}{'taken':>9}{'full':>8}"
    )
    print(f"\n{names}   [-, -, -, -, -, -, s, s]")
    for count, most, every_seed in ((100_000, SAMPLES, False), (300_000, SAMPLES, False), (3000, 1000, True)):
        part, few, full, fast, slow = agreement(count, most, every_seed)
        seeds = "all" if every_seed else "binned"
        print(f"{count:>10}{most:>7}{seeds:>8}{part:>12.4f}{few:>10}{full:>6}{fast:>9.2f}{slow:>8.1f}")


if __name__ == "__main__":
    main()
