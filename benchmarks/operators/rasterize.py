"""Time and memory of the rasterizer, beside the same loops in C.

    python -m benchmarks.operators.rasterize

Processor seconds of one thread, per Gaussian and pixel inside its cutoff: of the kernels' pixel loops alone, forward
(3 bases) and backward (gradients of all numbers of a footprint), in numba and in C (rasterize_loops.c, compiled here by
gcc -O3 -march=native -ffast-math, left out where there is no gcc); and of whole calls, which project Gaussians and
carry gradients back to them, too. Least of seven, taken in turns. Then whole calls, forward and backward, for up to a
million Gaussians. Prints, and writes to results/rasterize.txt beside this file.
"""

import ctypes
import platform
import resource
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numba import njit

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.simd import WIDTH
from recon.ops.arguments import GaussianTensors
from recon.ops.rasterize import CUTOFF, Projector, cpu, rasterize
from recon.ops.rasterize.cpu_calls import RasterizeCall
from spectra.threads import set_threads

PIXELS, BASES, SOD, SDD, SIZE = 256, 3, 500.0, 800.0, 100.0
PIXEL = SIZE / PIXELS  # edge of a pixel at the isocentre [mm]
SOURCE = Path(__file__).with_name("rasterize_loops.c")
EACH = (0,) * BASES  # as the kernels want it
FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", f"-DBASES={BASES}", f"-DWIDTH={WIDTH}")


def gaussians(count: int, sigma: float) -> list[torch.Tensor]:
    """Gaussians in a ball, `sigma` pixels wide give or take a half, turned all ways; float32."""
    rng = np.random.default_rng(1)
    way = rng.normal(size=(count, 3))
    centres = 0.45 * SIZE * way / np.linalg.norm(way, axis=1, keepdims=True) * rng.random((count, 1)) ** (1 / 3)
    scales = np.log(sigma * PIXEL * np.exp(rng.uniform(-0.4, 0.4, (count, 3))))
    parts = (centres, scales, rng.normal(size=(count, 4)), rng.random((count, BASES)))
    return [torch.tensor(part, dtype=torch.float32, requires_grad=True) for part in parts]


def frames(views: int) -> torch.Tensor:
    panel = Panel(PIXELS, PIXELS, PIXEL * SDD / SOD)
    return torch.from_numpy(Geometry.circular(SOD, SDD, np.linspace(0, 2, views), panel).ray_frames())


@njit
def gather(table, coefficients, cotangent, k2, columns, sums, lanes):
    """The backward kernel's sums over pixels, of all Gaussians."""
    for g in range(len(table)):
        lanes[:] = np.float32(0)
        cpu._gather(EACH, table[g], coefficients[g], cotangent, k2, columns, sums[g], lanes)


@njit
def inside(table, k2, columns):
    """Gaussian-pixels inside the cutoff."""
    total = 0
    for p in table:
        for row in range(int(p[cpu.ROW_0]), int(p[cpu.ROW_1])):
            low, high = cpu.row_span(p, np.float32(row) - p[cpu.YC], k2, columns)
            total += max(high - low, 0)
    return total


def least_seconds(tasks: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Least processor time of each task, which take turns."""
    least = dict.fromkeys(tasks, np.inf)
    for _ in range(8):  # the first compiles
        for name, task in tasks.items():
            begin = time.process_time()
            task()
            least[name] = min(least[name], time.process_time() - begin)
    return least


def compiled(folder: str) -> ctypes.CDLL | None:
    """The loops in C, None where there is no gcc."""
    compiler = shutil.which("gcc")
    if compiler is None:
        return None
    library = Path(folder) / "loops.so"
    subprocess.run([compiler, *FLAGS, str(SOURCE), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


def loops(sigma: float, count: int, c: ctypes.CDLL | None) -> str:
    """One line of the table of loops."""
    parts = gaussians(count, sigma)
    call = RasterizeCall(GaussianTensors(*parts), frames(1), (PIXELS, PIXELS), Projector())
    image = np.zeros((BASES, PIXELS, PIXELS + WIDTH), np.float32)
    call.values()
    views, weights = next(call.groups()), call.gaussians.coefficients
    table, lengths = views.tables[0], views.lengths[0]
    k2, cotangent = np.float32(CUTOFF**2), np.random.default_rng(0).normal(size=image.shape).astype(np.float32)
    cotangent[..., PIXELS:] = 0
    sums, lanes = np.zeros((count, 12)), np.zeros(BASES * WIDTH, np.float32)
    tasks: dict[str, Callable[[], object]] = {
        "forward": lambda: cpu.forward(EACH, table, weights, lengths, CUTOFF, 0, PIXELS, image),
        "backward": lambda: gather(table, weights, cotangent, k2, PIXELS, sums, lanes),
        "call": lambda: whole_call(parts, 1),
    }
    if c is not None:
        c_image, c_sums = np.zeros_like(image), np.zeros((count, 12 + BASES), np.float32)
        sizes = (ctypes.c_float(CUTOFF**2), count, PIXELS, PIXELS, PIXELS + WIDTH)
        arrays = [x.ctypes.data_as(ctypes.c_void_p) for x in (table, weights, c_image, cotangent, c_sums, lengths)]
        tasks["c forward"] = lambda: c.forward(*arrays[:2], arrays[5], arrays[2], *sizes)
        tasks["c backward"] = lambda: c.backward(*arrays[:2], arrays[3], arrays[4], *sizes)
    pixels = inside(table, k2, PIXELS)
    ns = {name: 1e9 * seconds / pixels for name, seconds in least_seconds(tasks).items()}
    line = f"{sigma:6.1f}{pixels / count:10.0f}{ns['forward']:12.2f}{ns['backward']:10.2f}"
    if c is not None:
        for array in (image, c_image):
            array[:] = 0
        tasks["forward"]()
        tasks["c forward"]()
        np.testing.assert_allclose(image[..., :PIXELS], c_image[..., :PIXELS], atol=1e-5 * image.max())
        np.testing.assert_allclose(c_sums[:, :12], sums, atol=1e-4 * abs(sums).max())
        both = (ns["forward"] + ns["backward"]) / (ns["c forward"] + ns["c backward"])
        line += f"{ns['c forward']:12.2f}{ns['c backward']:10.2f}{both:10.2f}"
    else:
        line += f"{'no gcc':>32s}"
    return line + f"{ns['call']:14.2f}"


def whole_call(parts: list[torch.Tensor], views: int) -> None:
    """Forward and backward."""
    image = rasterize(*parts, frames(views), PIXELS, PIXELS)  # type: ignore[arg-type]
    torch.autograd.grad(image.sum(), parts)


def scaling(count: int, views: int, sigma: float) -> str:
    """Processor time and growth of peak memory of whole calls."""
    parts = gaussians(count, sigma)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    seconds = least_seconds_of_two(lambda: whole_call(parts, views))
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    return f"{count:10d}{seconds:12.3f}{1e6 * seconds / count / views:22.2f}{grown:16.0f}"


def least_seconds_of_two(task: Callable[[], object]) -> float:
    times = []
    for _ in range(2):
        begin = time.process_time()
        task()
        times.append(time.process_time() - begin)
    return min(times)


def main() -> None:
    set_threads(1)
    lines = [
        f"{platform.machine()}, one thread, {PIXELS} x {PIXELS} pixels, {BASES} bases; ns per Gaussian and pixel",
        f"{'':16s}{'numba':>22s}{'C':>22s}{'numba/C':>10s}{'whole call':>14s}",
        f"{'sigma':>6s}{'pixels':>10s}{'forward':>12s}{'backward':>10s}{'forward':>12s}{'backward':>10s}",
    ]
    with tempfile.TemporaryDirectory() as folder:
        c = compiled(folder)
        lines += [loops(sigma, count, c) for sigma, count in ((0.5, 20000), (1.2, 20000), (2.5, 8000), (6.5, 2000))]
    lines += ["", "whole calls, forward and backward, 10 views, sigma of 1.2 pixels"]
    lines.append(f"{'Gaussians':>10s}{'seconds':>12s}{'us per Gaussian, view':>22s}{'peak grows MiB':>16s}")
    lines += [scaling(10**power, 10, 1.2) for power in (3, 4, 5, 6)]
    text = "\n".join(lines) + "\n"
    print(text)
    (Path(__file__).parents[1] / "results" / "rasterize.txt").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
