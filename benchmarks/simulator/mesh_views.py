"""Views of a sphere of a million triangles: time per view, error against the analytic sphere, wrong parities.

    python -m benchmarks.simulator.mesh_views

Prints, and writes to results/mesh_views.txt beside this file.
"""

import os
import platform
import time
from pathlib import Path

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.mesh import Surfaces, cpu, mesh_crossings, mesh_view
from spectra.threads import run_parallel, thread_count

RADIUS, VIEWS, SIDE = 50.0, 16, 256
GEOMETRY = Geometry.circular(
    500.0, 1000.0, np.linspace(0, 2 * np.pi, VIEWS, endpoint=False), Panel(SIDE, SIDE, (0.8, 0.8))
)
AT = np.arange(SIDE * SIDE)
UV = np.stack([AT % SIDE, AT // SIDE], axis=1).astype(np.float64)


def sphere(parts: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Octahedron with each edge cut in `parts`, blown up to a sphere: 8 parts^2 triangles."""
    i, j = np.array([(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]).T
    number = np.full((parts + 2, parts + 2), -1)
    number[i, j] = np.arange(len(i))
    up = np.stack([number[i, j], number[i + 1, j], number[i, j + 1]], axis=1)[i + j < parts]
    down = np.stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]], axis=1)[i + j < parts - 1]
    corner, face = np.stack([i, j, parts - i - j], axis=1), np.concatenate([up, down])
    corners, faces = [], []
    for signs in np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 8).T:
        faces.append((face if signs.prod() > 0 else face[:, ::-1]) + len(corner) * len(corners))
        corners.append(corner * signs)
    vertices, place = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    vertices = radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices, place.reshape(-1)[np.concatenate(faces)]


def centres(frame: np.ndarray, surfaces: Surfaces) -> np.ndarray:
    """Length inside of the ray through each pixel's centre [mm]."""
    view = mesh_view(frame, SIDE, SIDE, surfaces)
    norms = np.linalg.norm(frame[1] + UV @ frame[2:], axis=1)
    out = np.empty(SIDE * SIDE)
    cpu.ray_lengths(view.lists(0), UV, AT, norms, np.empty(view.room), out)
    return out


def chords(frame: np.ndarray) -> np.ndarray:
    """Length inside the analytic sphere of the same rays [mm]."""
    direction = frame[1] + UV @ frame[2:]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    missed = ((frame[0] - (direction @ frame[0])[:, None] * direction) ** 2).sum(axis=1)
    return 2 * np.sqrt(np.maximum(0, RADIUS**2 - missed))


def seconds(task, clock=time.thread_time, repeats: int = 5) -> float:
    """Least time of some runs; of this thread's processor only, which others on the machine disturb less."""
    times = []
    for _ in range(repeats):
        begin = clock()
        task()
        times.append(clock() - begin)
    return min(times)


def wrong_parities(vertices: np.ndarray, triangles: np.ndarray, rays: int, rng: np.random.Generator) -> int:
    """Rays of a view with an odd number of crossings: random ones, through vertices, and through points of edges."""
    frame, wrong = GEOMETRY.ray_frames()[3], 0
    for _ in range(rays // 1_000_000):
        picked = triangles[rng.integers(len(triangles), size=750_000)]
        part = rng.random((250_000, 1))
        first, second = vertices[picked[:250_000, 0]], vertices[picked[:250_000, 1]]
        points = np.concatenate([vertices[picked[250_000:, 0]], first + part * (second - first)])
        depth, a, b = np.linalg.solve(frame[1:].T, (points - frame[0]).T)
        aimed = np.stack([a / depth, b / depth], axis=1)
        uv = np.concatenate([aimed, rng.uniform(-0.5, SIDE - 0.5, (250_000, 2))])
        wrong += int((np.diff(mesh_crossings(frame, uv, vertices, triangles)[0]) % 2).sum())
    return wrong


def main() -> None:
    busy = f"{os.getloadavg()[0]:.1f} other processes busy" if hasattr(os, "getloadavg") else ""
    lines = [f"{platform.machine()}, {thread_count()} threads, {SIDE} x {SIDE} pixels, {busy}"]
    frames = GEOMETRY.ray_frames()
    lines.append(
        "triangles  ms per view: processor  wall, all threads  project + list  outline   worst, rms error [mm]"
    )
    for parts in (35, 112, 354):
        vertices, triangles = sphere(parts, RADIUS)
        surfaces = Surfaces.of([(vertices, triangles)])
        centres(frames[0], surfaces)
        single = seconds(lambda s=surfaces: centres(frames[0], s))
        listing = seconds(lambda s=surfaces: mesh_view(frames[0], SIDE, SIDE, s, with_outline=False))
        both = seconds(lambda s=surfaces: mesh_view(frames[0], SIDE, SIDE, s))
        every = (
            seconds(lambda s=surfaces: list(run_parallel(lambda f: centres(f, s), frames)), time.perf_counter) / VIEWS
        )
        error = centres(frames[0], surfaces) - chords(frames[0])
        lines.append(
            f"{len(triangles):9d} {1e3 * single:22.0f} {1e3 * every:18.0f} {1e3 * listing:15.0f}"
            f" {1e3 * (both - listing):8.1f}   {abs(error).max():9.2e} {np.sqrt((error**2).mean()):9.2e}"
        )
    rng = np.random.default_rng(1)
    for parts in (1, 35, 354):
        mesh = sphere(parts, RADIUS)
        begin = time.perf_counter()
        wrong = wrong_parities(*mesh, 10_000_000, rng)
        took = time.perf_counter() - begin
        lines.append(f"{wrong} of 10000000 rays have a wrong parity, {len(mesh[1])} triangles ({took:.0f} s)")
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parents[1] / "results" / "mesh_views.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
