"""Scenes of many objects: time per view of 256 x 256 pixels, and errors against brute force.

    python -m benchmarks.simulator.many_objects

Prints, and writes to results/many_objects.txt beside this file. Path lengths of single rays are compared with the
float64 reference that sorts all surface crossings; edge pixels with 128 x 128 rays each.
"""

import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.expected_counts import CROSSED, Sampling, Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace import trace
from phantomgen.ops.trace.reference import trace_one
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Box, Cone, Cylinder, Ellipsoid, Sphere, Tube, solids_of
from spectra.threads import run_parallel, thread_count

SIDE = 256
FRAMES = Geometry.circular(
    500.0, 800.0, np.linspace(0, 2 * np.pi, 8, endpoint=False), Panel(SIDE, SIDE, (0.8, 0.8))
).ray_frames()
ENERGIES = np.linspace(30, 120, 40)
# Plastic and three materials from air to bone, 4 channels of 10 energies.
ATTENUATION = np.stack([a * (70 / ENERGIES) ** b for a, b in ((0.018, 0.7), (0.0, 1), (0.02, 0.8), (0.05, 2))])
SPECTRUM = Spectrum(ATTENUATION, np.full(40, 5000.0), np.array([0, 10, 20, 30, 40]))
ONE_ENERGY = Spectrum(ATTENUATION[:, :1], np.ones(1), np.array([0, 1]))  # little but path lengths


def mixed(count: int) -> Solids:
    """A cylinder with spheres, ellipsoids, cylinders, boxes, frusta and tubes in it, turned any way, overlapping."""
    rng = np.random.default_rng(1)
    found = [(Cylinder((0, 0, 0), 50.0, 100.0), 0)]
    size = np.cbrt(0.2 * np.pi * 50**2 * 96 / count / (4 / 3 * np.pi))
    for i in range(count):
        turn, across = 2 * np.pi * rng.random(), 44 * np.sqrt(rng.random())
        center = (across * np.cos(turn), across * np.sin(turn), 88 * (rng.random() - 0.5))
        s, angles, axis = size * rng.uniform(0.5, 1.3), tuple(rng.uniform(0, 6, 3)), tuple(rng.normal(size=3))
        shape = (
            Sphere(center, s),
            Ellipsoid(center, (s, 0.6 * s, 1.2 * s), angles),
            Cylinder(center, 0.8 * s, 2 * s, axis),
            Box(center, (1.5 * s, s, 1.2 * s), angles),
            Cone(center, (s, 0.3 * s), 2 * s, axis),
            Tube(center, s, 0.6 * s, 1.5 * s, axis),
        )[i % 6]
        found.append((shape, int(rng.integers(1, 4))))
    return solids_of(found)


def foam(count: int) -> Solids:
    """The preset with so many bubbles."""
    return load_scene("foam", [f"objects.1.count={count}"]).scene.solids


def seconds(task: Callable[[], object], repeats: int) -> float:
    """Least processor time of this thread over some runs, which others on the machine disturb less than wall time."""
    times = []
    for _ in range(repeats):
        begin = time.thread_time()
        task()
        times.append(time.thread_time() - begin)
    return min(times)


def ray_error(solids: Solids, count: int) -> float:
    """Largest error of path lengths through random pixels [mm]."""
    uv = np.random.default_rng(0).uniform(40, SIDE - 40, (count, 2))
    directions = FRAMES[1, 1] + uv @ FRAMES[1, 2:]
    found = trace(np.tile(FRAMES[1, 0], (count, 1)), directions, solids, len(ATTENUATION))
    exact = [trace_one(FRAMES[1, 0], direction, solids, len(ATTENUATION)) for direction in directions]
    return float(np.abs(found - exact).max())


def times_of(view: Callable[[np.ndarray], object], heavy: bool) -> str:
    """Time of a view on one thread, and on all threads that each compute views."""
    view(FRAMES[1])
    alone = seconds(lambda: view(FRAMES[1]), 1 if heavy else 10)
    some = FRAMES[: thread_count()] if heavy else np.tile(FRAMES, (4, 1, 1))
    begin = time.perf_counter()
    list(run_parallel(view, some))
    wall = (time.perf_counter() - begin) / len(some)
    return f"{1e3 * alone:14.1f} {1e3 * wall:12.1f}"


def lines_of(name: str, solids: Solids, rules: tuple[int | None, ...], rays: int) -> list[str]:
    """One line per way to average over pixels, after one for a single energy."""
    single = f"{ray_error(solids, rays):9.1e}" if rays else ""

    def lengths(frame: np.ndarray):
        return expected_counts(frame, SIDE, SIDE, solids, ONE_ENERGY, sampling=Sampling(sub_rays=1))

    times = times_of(lengths, solids.rows > 20_000)
    lines = [f"{name:<14} {'1 energy':<8} {lengths(FRAMES[1]).rays.sum() / SIDE**2:10.1f} {times}{'':23}{single}"]
    print(lines[0], flush=True)
    classes = expected_counts(FRAMES[1], SIDE, SIDE, solids, SPECTRUM, sampling=Sampling(sub_rays=2)).classes
    pixels = np.argwhere(classes >= CROSSED)
    pixels = pixels[np.random.default_rng(0).choice(len(pixels), 24, replace=False)]
    exact = np.concatenate(
        list(
            run_parallel(lambda p: expected_counts_by_grid(FRAMES[1], p, solids, SPECTRUM, n=128), np.split(pixels, 6))
        )
    )
    for sub_rays in rules:
        heavy = sub_rays != 1 or solids.rows > 20_000

        def view(frame: np.ndarray, sub_rays: int | None = sub_rays):
            return expected_counts(frame, SIDE, SIDE, solids, SPECTRUM, sampling=Sampling(sub_rays=sub_rays))

        found, times = view(FRAMES[1]), times_of(view, heavy)
        error = np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T / exact)
        way = "split" if sub_rays is None else f"{sub_rays} x {sub_rays}"
        lines.append(
            f"{name:<14} {way:<8} {found.rays.sum() / SIDE**2:10.1f} {times}"
            f"   {np.sqrt((error**2).mean()):8.1e} {np.abs(error).max():8.1e}"
        )
        print(lines[-1], flush=True)
    return lines


def main() -> None:
    busy = f"{os.getloadavg()[0]:.1f} processes busy before the start" if hasattr(os, "getloadavg") else ""
    lines = [
        f"{platform.machine()}, {thread_count()} threads, {SIDE} x {SIDE} pixels, 40 energies, 4 materials, {busy}",
        "scene          pixels   rays/pixel   ms/view: one thread  all threads   "
        "log error of edge pixels: rms, worst   path length, worst [mm]",
    ]
    lines += lines_of("1001 mixed", mixed(1000), (1, 2, 4, None), 0)
    lines += lines_of("foam 1e3", foam(1000), (1, 2, 4, None), 20)
    lines += lines_of("foam 1e4", foam(10_000), (1, 4), 0)
    lines += lines_of("foam 1e5", foam(100_000), (1, 4), 0)
    text = "\n".join(lines) + "\n"
    (Path(__file__).parents[1] / "results" / "many_objects.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
