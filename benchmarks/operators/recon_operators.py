"""Processor time and results of the reconstructor's operators on the CPU, here and in another checkout.

    python -m benchmarks.operators.recon_operators
    python -m benchmarks.operators.recon_operators --against ../other-checkout --rounds 15

Every operator runs once to compile (or to load what numba has stored: `--compile` starts from an empty store), then in
rounds; the two checkouts take turns in each round, in a process of one thread each. A line holds the median time of a
call, the ratio of the medians, the time of the first call, and whether both gave the same bits. The other checkout
needs this file too.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.ops.backproject import backproject
from recon.ops.chords import chords, fill
from recon.ops.decompose import decompose
from recon.ops.likelihood import MeasuredCounts, likelihood
from recon.ops.nonnegative_newton import inverse_blocks, nonnegative_newton_step
from recon.ops.rasterize import Projector, rasterize
from recon.ops.total_variation import ascend, gradient, total_variation
from recon.ops.voxelize import voxelize_tensor
from spectra.threads import set_threads
from spectra.transmission import Transmission

SIDE, BASES = 64, 3  # pixels and voxels along an edge; bases
GRID = Grid((SIDE, SIDE, SIDE), (1.0, 1.0, 1.0), (-SIDE / 2, -SIDE / 2, -SIDE / 2))


def scan_geometry(views: int, sod: float = 300.0) -> Geometry:
    """Views of a cone beam; with an object that reaches the source where `sod` [mm] is small."""
    return Geometry.circular(sod, 2 * sod, np.linspace(0, 2, views), Panel(SIDE, SIDE, 2.0))


def gaussians(count: int, sigma: float, bases: int = BASES) -> list[torch.Tensor]:
    """Gaussians in a ball of the grid's size, `sigma` mm wide give or take a third; float32 with gradients."""
    rng = np.random.default_rng(1)
    way = rng.normal(size=(count, 3))
    centres = 0.45 * SIDE * way / np.linalg.norm(way, axis=1, keepdims=True) * rng.random((count, 1)) ** (1 / 3)
    scales = np.log(sigma) + rng.uniform(-0.4, 0.4, (count, 3))
    parts = (centres, scales, rng.normal(size=(count, 4)), rng.random((count, bases)))
    return [torch.tensor(part, dtype=torch.float32, requires_grad=True) for part in parts]


def with_gradients(function: Callable[..., torch.Tensor], parts: list[torch.Tensor]) -> tuple[torch.Tensor, ...]:
    """Value of an operator and the gradients of a fixed weighting of it."""
    value = function(*parts)
    cotangent = torch.linspace(-1, 1, value.numel()).reshape(value.shape)
    return value.detach(), *torch.autograd.grad(value, parts, cotangent)


def transmission() -> Transmission:
    """Five channels of eight energies, and functions of energy like those of attenuation."""
    energies, starts = np.linspace(20, 120, 40), np.arange(0, 41, 8)
    columns = np.stack([(energies / 70) ** -3, (energies / 70) ** -0.3, (energies > 60) * (energies / 70) ** -3])
    return Transmission(columns, np.full(40, 2000.0), starts)


def projectors() -> dict[str, Callable[[], Any]]:
    """Operators of Gaussians and ellipsoids."""
    some, wide, frames = gaussians(3000, 1.0), gaussians(60, 6.0), torch.from_numpy(scan_geometry(4).ray_frames())
    close, view = torch.from_numpy(scan_geometry(2, 24.0).ray_frames()), (SIDE, SIDE)
    return {
        "rasterize": lambda: with_gradients(lambda *p: rasterize(*p, frames, *view), some),
        "rasterize few": lambda: with_gradients(lambda *p: rasterize(*p, frames, *view), wide),
        "rasterize near": lambda: with_gradients(lambda *p: rasterize(*p, close, *view), wide),
        "rasterize 1 basis": lambda: with_gradients(lambda *p: rasterize(*p, frames, *view), gaussians(3000, 1.0, 1)),
        "local-affine": lambda: with_gradients(
            lambda *p: rasterize(*p, frames, *view, Projector(kind="local-affine")), some
        ),
        "voxelize": lambda: with_gradients(lambda *p: voxelize_tensor(*p, GRID), some),
        "chords": lambda: with_gradients(lambda *p: chords(*p, frames, *view), some),
        "chords fill": lambda: fill(*(part.detach() for part in some[:3]), some[3][:, 0], GRID),
    }


def spectral() -> dict[str, Callable[[], Any]]:
    """Operators of counts."""
    rng, model = np.random.default_rng(2), transmission()
    rays = rng.uniform(0, 1, (20000, BASES))
    counts = rng.poisson(model.expected(rays)).astype(float)
    gains, known = rng.uniform(0.8, 1.2, counts.shape), rays[:, 2:].copy()
    lengths = rng.uniform(0, 1, (BASES, 6, SIDE, SIDE)).astype(np.float32)
    images = np.moveaxis(model.expected(np.moveaxis(lengths, 0, -1)), -1, 1).astype(np.float32)
    pixels, exposure = np.ones((5, SIDE, SIDE), np.float32), np.ones((6, 5))
    shared = MeasuredCounts(images, pixels, exposure, lengths[2, :1], images / 1e4)
    return {
        "decompose": lambda: decompose(counts, gains, model, 0.01),
        "decompose known": lambda: decompose(counts, gains, model, 0.01, known=known),
        "likelihood": lambda: likelihood(lengths, MeasuredCounts(1.1 * images, pixels, exposure), model, 0.01)[:2],
        "likelihood known": lambda: likelihood(lengths[:2], shared, model, 0.01, information=True),
    }


def voxelwise() -> dict[str, Callable[[], Any]]:
    """Operators of volumes."""
    rng, found = np.random.default_rng(3), {}
    volumes = rng.normal(size=(4, *GRID.shape)).astype(np.float32)
    for bases in (2, 3, 4):
        blocks = 0.1 * rng.normal(size=(bases * (bases + 1) // 2, *GRID.shape)).astype(np.float32)
        blocks[[i * bases - i * (i - 1) // 2 for i in range(bases)]] += 1
        x, floor = volumes[:bases], np.full(bases, 0.1)
        found[f"newton {bases}"] = lambda x=x, b=blocks: nonnegative_newton_step(x, b, x[::-1])
        found[f"inverse {bases}"] = lambda f=floor, b=blocks: inverse_blocks(b, f)
    x, mixing, ones = volumes[:BASES], np.eye(BASES, dtype=np.float32) + 0.1, np.ones(GRID.shape, np.float32)
    field = rng.normal(size=(3, BASES, *GRID.shape)).astype(np.float32)

    def ascended() -> np.ndarray:
        moved = field.copy()
        ascend(moved, x, mixing, GRID, ones, ones)
        return moved

    geometry = scan_geometry(6)
    images, scales = rng.normal(size=(6, BASES, SIDE, SIDE)).astype(np.float32), np.full(6, 0.5)
    return found | {
        "total variation": lambda: np.array(total_variation(x, mixing, GRID)),
        "ascend": ascended,
        "tv gradient": lambda: gradient(field, mixing, GRID),
        "backproject": lambda: backproject(images, geometry, GRID, scales),
    }


def digest(found: Any) -> str:
    """First digits of SHA-256 of arrays, tensors or tuples of them."""
    state = hashlib.sha256()
    for part in found if isinstance(found, tuple) else (found,):
        array = part.detach().numpy() if isinstance(part, torch.Tensor) else np.asarray(part)
        state.update(np.ascontiguousarray(array).tobytes())
    return state.hexdigest()[:12]


def work() -> None:
    """Run the cases that the standard input names; answer with processor seconds and a digest."""
    set_threads(1)
    cases = projectors() | spectral() | voxelwise()
    print(json.dumps(list(cases)), flush=True)
    for line in sys.stdin:
        begin = time.process_time()
        found = cases[line.strip()]()
        print(json.dumps((time.process_time() - begin, digest(found))), flush=True)


class Checkout:
    """A process that runs the operators of one checkout."""

    def __init__(self, root: Path, store: Path | None) -> None:
        extra = {} if store is None else {"NUMBA_CACHE_DIR": str(store)}
        environment = {**os.environ, "PYTHONPATH": str(root), "OMP_NUM_THREADS": "1", **extra}
        command = [sys.executable, "-m", "benchmarks.operators.recon_operators", "--worker"]
        self.process = subprocess.Popen(
            command, cwd=root, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.cases = self.answer()

    def answer(self) -> Any:
        """Return the next line of the process."""
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def run(self, case: str) -> tuple[float, str]:
        """Return processor seconds and digest of one call."""
        assert self.process.stdin is not None
        print(case, file=self.process.stdin, flush=True)
        seconds, found = self.answer()
        return seconds, found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--against", type=Path, help="another checkout to compare with")
    parser.add_argument("--rounds", type=int, default=7, help="calls of each operator after the first")
    parser.add_argument("--only", action="append", help="operator to run; repeatable")
    parser.add_argument("--compile", action="store_true", help="compile all kernels anew")
    parser.add_argument("--worker", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.worker:
        work()
        return
    roots = [Path(__file__).parents[2], *([arguments.against.resolve()] if arguments.against else [])]
    with tempfile.TemporaryDirectory() as folder:
        stores = [Path(folder, str(i)) if arguments.compile else None for i in range(len(roots))]
        checkouts = [Checkout(root, store) for root, store in zip(roots, stores, strict=True)]
        print(f"{'':18s}{'ms here':>10s}{'there':>10s}{'ratio':>8s}{'first s':>10s}{'there':>8s}   bits")
        for case in arguments.only or checkouts[0].cases:
            print(row(case, checkouts, arguments.rounds), flush=True)
        for checkout in checkouts:
            checkout.process.terminate()


def row(case: str, checkouts: list[Checkout], rounds: int) -> str:
    """One line of the table."""
    first = [checkout.run(case) for checkout in checkouts]
    times = np.array([[checkout.run(case)[0] for checkout in checkouts] for _ in range(rounds)])
    middle = [*1e3 * np.median(times, axis=0), np.nan][:2]
    begins = [*(seconds for seconds, _ in first), np.nan][:2]
    bits = "" if len(first) == 1 else "same" if first[0][1] == first[1][1] else "DIFFER"
    ratio = middle[0] / middle[1]
    return f"{case:18s}{middle[0]:10.2f}{middle[1]:10.2f}{ratio:8.3f}{begins[0]:10.2f}{begins[1]:8.2f}   {bits}"


if __name__ == "__main__":
    main()
