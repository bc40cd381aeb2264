"""Pixels where surfaces intersect, mesh edges pass or clips cut: error against 256 x 256 rays, rays and time.

    python -m benchmarks.simulator.intersection_pixels

Prints, and writes to results/intersection_pixels.txt beside this file.
"""

import platform
import time
from pathlib import Path

import numpy as np
import trimesh

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import (
    CROSSED,
    INTERSECTED,
    Sampling,
    Spectrum,
    expected_counts,
    expected_counts_by_grid,
)
from phantomgen.ops.solids import Solids
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, Cylinder, Difference, HalfSpace, Intersection, Mesh, Shape, Sphere, Union, solids_of
from spectra.threads import run_parallel

SIDE, RAYS, SAMPLE = 128, 256, 96
TOLERANCES = (1e-2, 1e-3, 3e-4, 1e-4, 1e-5)
FRAME = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(SIDE, SIDE, (1.6, 1.6))).ray_frames()[0]
ENERGIES = np.linspace(30, 120, 20)
ATTENUATION = np.stack([a * (70 / ENERGIES) ** b for a, b in ((0.02, 0.8), (0.06, 2), (0.1, 2.2), (0.04, 1.5))])
STARTS = np.array([0, 5, 10, 15, 20])
BODY: tuple[Shape, int] = (Cylinder((0, 0, 0), 50.0, 100.0), 0)


def bodies() -> dict[str, Solids]:
    """Scenes of few shapes that intersect, in a cylinder of soft tissue."""
    first, second = Cylinder((3, 2, 1), 14.0, 70.0, (0.3, 0.2, 1)), Cylinder((0, 0, 0), 10.0, 80.0, (1, 0.4, 0.1))
    tube = trimesh.creation.annulus(12.0, 16.0, 70.0, sections=24)
    ball = trimesh.creation.icosphere(3, 20.0)
    return {
        "two cylinders": solids_of([BODY, (Union((first, second)), 1)]),
        "of two materials": solids_of([BODY, (first, 1), (second, 2)]),
        "difference": solids_of([BODY, (Difference(Sphere((5, 0, 0), 26.0), (Box((20, 5, 5), (30, 24, 30)),)), 1)]),
        "cut sphere": solids_of([BODY, (Intersection((Sphere((2, 3, 4), 28.0), HalfSpace((1, 0.5, 0.3), 5.0))), 1)]),
        "mesh tube": solids_of([BODY, (Mesh(np.asarray(tube.vertices), np.asarray(tube.faces)), 1), (second, 3)]),
        "mesh ball": solids_of([BODY, (Mesh(np.asarray(ball.vertices), np.asarray(ball.faces)), 1), (second, 3)]),
    }


def aorta() -> tuple[np.ndarray, int, int, Solids]:
    """First view of the preset: its rays, pixels and objects."""
    scan = load_scene("aorta")
    panel = scan.geometry.panel
    return scan.geometry.ray_frames()[0], panel.rows, panel.columns, scan.scene.solids


def spectrum(solids: Solids) -> Spectrum:
    """Energies for as many materials as there are."""
    count = int(solids.materials.max()) + 1
    curves = ATTENUATION if count <= 4 else np.concatenate([ATTENUATION, ATTENUATION[: count - 4] * 0.7])
    return Spectrum(curves, np.full(20, 5000.0), STARTS)


def log_error(found: np.ndarray, exact: np.ndarray) -> str:
    """Root mean square and largest size of the errors of log counts."""
    error = np.log(found / exact)
    return f"{np.sqrt((error**2).mean()):8.1e} {np.abs(error).max():8.1e}"


def rows_of(name: str, frame: np.ndarray, rows: int, columns: int, solids: Solids) -> list[str]:
    """One line for a plain grid, and one for each tolerance."""
    args = (solids, spectrum(solids))

    def brute(pixels: np.ndarray, n: int) -> np.ndarray:
        pieces = np.array_split(pixels, max(1, len(pixels) // 8))
        return np.concatenate(list(run_parallel(lambda p: expected_counts_by_grid(frame, p, *args, n=n), pieces)))

    classes, rng = expected_counts(frame, rows, columns, *args).classes, np.random.default_rng(0)
    chosen = [np.argwhere(classes == kind) for kind in (INTERSECTED, CROSSED)]
    counted, chosen = len(chosen[0]), [rng.permutation(pixels)[:SAMPLE] for pixels in chosen]
    exact = [brute(pixels, RAYS) for pixels in chosen]
    lines = [f"{name:<17} {'16 x 16':<8} {counted:7d} {256:8d}   {log_error(brute(chosen[0], 16), exact[0])}"]
    print(lines[-1], flush=True)
    for tolerance in TOLERANCES:
        times = []
        for _ in range(3):
            begin = time.thread_time()
            found = expected_counts(frame, rows, columns, *args, sampling=Sampling(intersection_tolerance=tolerance))
            times.append(time.thread_time() - begin)
        errors = [log_error(found.counts[:, p[:, 0], p[:, 1]].T, e) for p, e in zip(chosen, exact, strict=True)]
        each = found.rays[INTERSECTED] / max(1, counted)
        lines.append(
            f"{name:<17} {tolerance:<8.0e} {counted:7d} {each:8.0f}   {errors[0]}   {errors[1]} {1e3 * min(times):9.1f}"
        )
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    lines = [
        f"{platform.machine()}, one thread, {SIDE} x {SIDE} pixels (aorta: 182 x 158), 4 channels of 5 energies",
        f"against {RAYS} x {RAYS} rays in up to {SAMPLE} pixels of each class",
        "scene             rule      intersected rays each   intersected: rms, worst  crossed: rms, worst   ms/view",
    ]
    print("\n".join(lines))
    for name, solids in bodies().items():
        lines += rows_of(name, FRAME, SIDE, SIDE, solids)
    lines += rows_of("aorta", *aorta())
    text = "\n".join(lines) + "\n"
    (Path(__file__).parents[1] / "results" / "intersection_pixels.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
