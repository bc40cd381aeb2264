"""Voxel projectors compared: error against exact chords through what was voxelized, and time per view.

    python -m benchmarks.operators.voxel_projector
    python -m benchmarks.operators.voxel_projector --device cuda

A ball and a tilted cylinder are voxelized by volume fractions and projected from six sides. Errors are rms over all
pixels, against the exact chord of the central ray and against the mean of 8 x 8 exact chords per pixel, in % of the
longest chord. Times are those of one thread, for one component, and for each of four at once; all projectors but the
last are written out below. On a GPU, the Triton kernels are timed on as many components, and compared with numba's: the
greatest difference is in % of the greatest value. Without one, that is left out. Prints, and writes to
results/voxel_projector.txt beside this file, with a GPU to results/voxel_projector_cuda.txt.
"""

import argparse
import os
import platform
import time
from math import floor
from pathlib import Path

import numpy as np
import torch
from numba import njit

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Cylinder, Sphere, solids_of
from spectra.threads import set_threads

SIZE, ANGLES = 128.0, np.deg2rad([0.0, 17.0, 33.0, 45.0, 60.0, 80.0])
SOLIDS = solids_of([(Sphere((18, -9, 7), 24.0), 0), (Cylinder((-14, 12, -3), 17.0, 60.0, (1, 2, 3)), 0)])


@njit(cache=True, error_model="numpy")
def siddon(volume, start, ways, out):
    """Exact path through voxels of constant value, per unit of t."""
    shape, index, step, ahead = np.array(volume.shape), np.zeros(3, np.int64), np.zeros(3, np.int64), np.zeros(3)
    for ray in range(len(ways)):
        way, t, end, total = ways[ray], 0.0, 1.0, 0.0
        for i in range(3):
            if way[i] == 0.0:
                end = end if -0.5 <= start[i] < shape[i] - 0.5 else -1.0
            else:
                one, other = (-0.5 - start[i]) / way[i], (shape[i] - 0.5 - start[i]) / way[i]
                t, end = max(t, min(one, other)), min(end, max(one, other))
        for i in range(3):
            index[i] = min(shape[i] - 1, max(0, floor(start[i] + t * way[i] + 0.5)))
            step[i] = 1 if way[i] > 0 else -1
            ahead[i] = (index[i] + 0.5 * step[i] - start[i]) / way[i] if way[i] != 0 else np.inf
        while t < end:
            i = 0 if ahead[0] <= ahead[1] else 1
            i = i if ahead[i] <= ahead[2] else 2
            past = min(ahead[i], end)
            total += max(0.0, past - t) * volume[index[0], index[1], index[2]]
            t = max(t, past)
            index[i] += step[i]
            if not 0 <= index[i] < shape[i]:
                break
            ahead[i] = (index[i] + 0.5 * step[i] - start[i]) / way[i]
        out[ray] = total


@njit(cache=True, error_model="numpy")
def interpolated(volume, place):
    """Trilinear interpolation; there is nothing outside."""
    z, y, x = floor(place[0]), floor(place[1]), floor(place[2])
    total = 0.0
    for i in range(8):
        k, j, m = z + i // 4, y + i // 2 % 2, x + i % 2
        if 0 <= k < volume.shape[0] and 0 <= j < volume.shape[1] and 0 <= m < volume.shape[2]:
            total += (1 - abs(place[0] - k)) * (1 - abs(place[1] - j)) * (1 - abs(place[2] - m)) * volume[k, j, m]
    return total


@njit(cache=True, error_model="numpy")
def sampled(volume, start, ways, nodes, out):
    """Gauss nodes between the layers across a ray's main axis; one in the middle of each layer is Joseph's method."""
    offset = 0.0 if nodes == 1 else 0.5 / np.sqrt(3.0)
    for ray in range(len(ways)):
        way, total = ways[ray], 0.0
        axis = np.abs(way).argmax()
        for k in range(-1, volume.shape[axis]):
            for i in range(nodes):
                t = (k + (0.0 if nodes == 1 else 0.5 + (2 * i - 1) * offset) - start[axis]) / way[axis]
                if 0 < t < 1:
                    total += interpolated(volume, start + t * way) / nodes
        out[ray] = total / abs(way[axis])


class Case:
    """One size of voxels and of pixels; the object fills most of the panel."""

    def __init__(self, voxels: int, pixels: int) -> None:
        self.grid, self.pixels = Grid.cube(voxels, SIZE), pixels
        panel = Panel(pixels, pixels, 1.6 * SIZE / pixels)
        self.frames = Geometry.circular(500.0, 800.0, ANGLES, panel).ray_frames()
        self.volume = fractions(self.grid, SOLIDS, 1)
        self.centre, self.mean = self.exact(1), self.exact(8)

    def ways(self, frame: np.ndarray, du: float, dv: float) -> np.ndarray:
        at = np.arange(self.pixels)
        return (frame[1] + (at + du)[:, None] * frame[2] + (at + dv)[:, None, None] * frame[3]).reshape(-1, 3)

    def over_pixels(self, one, n: int) -> np.ndarray:
        """Mean over n x n rays per pixel of what `one` makes of a frame and its rays."""
        places = (np.arange(n) + 0.5) / n - 0.5
        views = [sum(one(f, self.ways(f, du, dv)) for dv in places for du in places) / n**2 for f in self.frames]
        return np.reshape(views, (len(self.frames), self.pixels, self.pixels))

    def exact(self, n: int) -> np.ndarray:
        return self.over_pixels(lambda f, ways: trace(np.broadcast_to(f[0], ways.shape), ways, SOLIDS, 1)[:, 0], n)

    def by_rays(self, kernel, *options, n: int = 1) -> np.ndarray:
        def one(frame: np.ndarray, ways: np.ndarray) -> np.ndarray:
            start = (frame[0, ::-1] - self.grid.origin) / self.grid.spacing
            out = np.empty(len(ways))
            kernel(self.volume[0], start, np.ascontiguousarray(ways[:, ::-1] / self.grid.spacing), *options, out)
            return out * np.linalg.norm(ways, axis=1)

        return self.over_pixels(one, n)

    def by_project(self, components: int = 1) -> np.ndarray:
        volume = np.repeat(self.volume, components, axis=0)
        return project(volume, self.grid, self.frames, self.pixels, self.pixels)[0]

    def transposed(self, components: int = 1) -> np.ndarray:
        return project_transpose(np.repeat(self.mean[None], components, axis=0), self.grid, self.frames)


def seconds(task, clock=time.thread_time) -> float:
    """Least time per view of three runs; of this thread's processor only, which others disturb less."""
    task()
    times = []
    for _ in range(3):
        begin = clock()
        task()
        times.append(clock() - begin)
    return min(times) / len(ANGLES)


def on_gpu(case: Case) -> list[str]:
    """Time and differences of the Triton kernels; a tensor on a GPU is all that they take."""
    tasks = {
        "project": (case.volume, lambda x: project(x, case.grid, case.frames, case.pixels, case.pixels)),
        "project_transpose": (case.mean[None], lambda y: project_transpose(y, case.grid, case.frames)),
    }
    lines = []
    for name, (values, task) in tasks.items():
        one, four = (torch.tensor(np.repeat(values, n, axis=0), dtype=torch.float32, device="cuda") for n in (1, 4))
        wanted, times = task(values.astype(np.float32)), []
        for tensor in (one, four):
            # Copying one number back waits for the rest.
            times.append(seconds(lambda x=tensor, f=task: f(x).flatten()[-1].item(), time.perf_counter))
        difference = abs(task(one).cpu().numpy() - wanted).max() / abs(wanted).max()
        label, both = f"{name} on GPU, and each of 4", f"{1e3 * times[0]:.2f} {1e3 * times[1] / 4:.2f}"
        lines.append(f"{label:42s}{both:>42s}   differs by {100 * difference:.1e} %")
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description="Voxel projectors compared: errors and times.")
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu", help="cuda: the GPU, too")
    with_gpu = parser.parse_args().device == "cuda" and torch.cuda.is_available()
    set_threads(1)
    busy = f"{os.getloadavg()[0]:.1f} processes busy" if hasattr(os, "getloadavg") else ""
    lines = [f"{platform.machine()}, one thread, {busy}; errors in % of the longest chord"]
    lines += [f"GPU: {torch.cuda.get_device_name()}"] if with_gpu else []
    for voxels, pixels in ((64, 64), (128, 128), (256, 256), (128, 256), (128, 64), (128, 32)):
        case = Case(voxels, pixels)
        lines.append(f"\n{voxels}^3 voxels, {pixels}^2 pixels   central ray  pixel mean  worst of these  ms per view")
        methods = {
            "Siddon, nearest voxel": lambda c=case: c.by_rays(siddon),
            "Siddon, 3 x 3 rays": lambda c=case: c.by_rays(siddon, n=3),
            "Joseph": lambda c=case: c.by_rays(sampled, 1),
            "trilinear": lambda c=case: c.by_rays(sampled, 2),
            "project": case.by_project,
        }
        for name, method in methods.items():
            scale, found = 100 / case.centre.max(), method()
            central, mean = (scale * (found - truth) for truth in (case.centre, case.mean))
            lines.append(
                f"{name:28s} {np.sqrt((central**2).mean()):12.3f} {np.sqrt((mean**2).mean()):11.3f}"
                f" {abs(mean).max():15.2f} {1e3 * seconds(method):12.1f}"
            )
        four = seconds(lambda c=case: c.by_project(4)) / 4
        back, back_four = seconds(case.transposed), seconds(lambda c=case: c.transposed(4)) / 4
        lines.append(f"project, each of 4 {1e3 * four:60.1f}")
        lines.append(f"project_transpose, and each of 4 {1e3 * back:46.1f} {1e3 * back_four:.1f}")
        lines += on_gpu(case) if with_gpu else []
    text = "\n".join(lines) + "\n"
    print(text)
    file = "voxel_projector_cuda.txt" if with_gpu else "voxel_projector.txt"
    (Path(__file__).parents[1] / "results" / file).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
