"""Every kernel on a GPU beside the processor, and the default fit of two scans on both.

    python -m benchmarks.gpu [--without-tests] [--quick]

Kernels: largest error of values, and error of gradients (norm of the difference over the norm), in float32 on the GPU
against the numba kernels, which the tests compare with float64 references; milliseconds of both. The tests of these
kernels run on the GPU as well. Fits: `recon fit` of `kedge-small` (64^3 voxels), `kedge` (128^3 voxels, 75 views of
256^2 in four channels), and of the same scene at 256^3 voxels and 512^2 pixels, by the GPU and by the processor,
without figures: PSNR, seconds up to the volumes by stage, seconds of the whole command, and memory. The first command
compiles kernels; it is told apart. Prints, and writes `results/gpu.md` row by row. `--quick` fits `kedge-small` alone.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

import phantomgen
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import project, project_transpose
from recon.ops.arguments import GaussianTensors
from recon.ops.interface.arrays import DividedTensors
from recon.ops.interface.rasterize import rasterize_divided
from recon.ops.interface.voxelize import voxelize_divided
from recon.ops.likelihood import MeasuredCounts, likelihood, tensors
from recon.ops.nonnegative_newton import nonnegative_newton_step
from recon.ops.rasterize import Projector, rasterize
from recon.ops.total_variation import ascend, gradient
from recon.ops.voxelize import voxelize_tensor
from spectra.differentiable import transmit
from spectra.threads import thread_count
from spectra.transmission import Transmission

TABLE = Path(__file__).parent / "results" / "gpu.md"
TESTS = (
    "tests/spectra/ops/test_transmit_gpu.py", "tests/phantomgen/ops/test_project_gpu.py",
    "tests/recon/ops/test_rasterize_gpu.py", "tests/recon/ops/test_voxelize_gpu.py",
    "tests/recon/ops/interface/test_gpu.py", "tests/recon/ops/test_total_variation.py",
    "tests/recon/ops/test_nonnegative_newton.py", "tests/recon/voxel/iterative/test_one_step.py::"
    "test_tensors_give_the_same_volumes",
)  # fmt: skip
VOXELS, PIXELS, VIEWS, GAUSSIANS = 128, 256, 15, 4000
LARGE = {"volume.voxels": 256, "panel": {"rows": 512, "columns": 512, "pitch": 0.4}, "geometry.test_views": 20}
FIT = ("check", "basis", "read", "one-step", "initialize", "approximate", "fit", "judge", "mark")  # up to the volumes
REPEATS = 5

Values = Sequence[torch.Tensor]
Kernel = Callable[..., Values]


def scene(seed: int = 0) -> tuple[list[torch.Tensor], Geometry, Grid]:
    """Gaussians as a fit of `kedge` has them, views and grid."""
    random = np.random.default_rng(seed)
    centres, quaternions = random.uniform(-45, 45, (GAUSSIANS, 3)), random.normal(size=(GAUSSIANS, 4))
    scales = np.log(random.uniform(1.0, 5.0, (GAUSSIANS, 3)))
    planes = np.stack([random.normal(0, 1, GAUSSIANS), np.full(GAUSSIANS, 0.1)], 1)
    sides = random.uniform(0, 0.002, (2, GAUSSIANS, 3))
    parts = [torch.from_numpy(part).float() for part in (centres, scales, quaternions, planes, *sides)]
    angles = np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    geometry = Geometry.circular(500.0, 800.0, angles, Panel(PIXELS, PIXELS, 0.8))
    return parts, geometry, Grid.cube(VOXELS, 128.0)


def transmission() -> Transmission:
    """Four channels of three nodes and three bases."""
    energy = np.linspace(25, 115, 12)
    columns = np.stack([(70 / energy) ** 3, (70 / energy) ** 0.3, np.where(energy > 63, (70 / energy) ** 3, 0.02)])
    return Transmission(columns, np.full(12, 3e4), np.arange(0, 13, 3))


@lru_cache
def weights_of(shape: tuple[int, ...], device: torch.device) -> torch.Tensor:
    """Random weights of values, which are the same on every device."""
    return torch.from_numpy(np.random.default_rng(1).normal(size=shape).astype(np.float32)).to(device)


def with_gradients(function: Callable[..., torch.Tensor], parts: Values) -> Values:
    """Values of a function, and its gradients for random weights."""
    leaves = [part.detach().clone().requires_grad_() for part in parts]
    values = function(*leaves)
    return [values.detach(), *torch.autograd.grad(values, leaves, weights_of(tuple(values.shape), values.device))]


def kernels() -> dict[str, tuple[Kernel, Values]]:
    """Kernels by name: a function of tensors, and the tensors."""
    parts, geometry, grid = scene()
    frames, random = torch.from_numpy(geometry.ray_frames()), np.random.default_rng(2)
    volumes = torch.from_numpy(random.uniform(0, 0.02, (3, *grid.shape)).astype(np.float32))
    images = torch.from_numpy(random.normal(size=(3, VIEWS, PIXELS, PIXELS)).astype(np.float32))
    lengths = torch.from_numpy(random.uniform(0, 2, (VIEWS, PIXELS, PIXELS, 3)).astype(np.float32))
    field = torch.from_numpy(random.normal(size=(3, *volumes.shape)).astype(np.float32))
    steps = torch.from_numpy(random.uniform(0, 1, grid.shape).astype(np.float32))
    roots = random.normal(size=(*grid.shape, 3, 3)).astype(np.float32)
    inverse = torch.from_numpy((roots @ roots.swapaxes(-1, -2))[..., *np.triu_indices(3)]).movedim(-1, 0).contiguous()
    model, mixing = transmission(), random.normal(size=(3, 3)).T
    expected = np.moveaxis(model.expected(lengths.numpy().astype(float)), -1, 1)
    counts = random.poisson(expected).astype(np.float32)
    measured = MeasuredCounts(counts, np.ones(counts.shape[1:], np.float32), np.ones(counts.shape[:2]))
    plain = [*parts[:3], parts[4]]

    def plain_rays(*some: torch.Tensor) -> torch.Tensor:
        return rasterize(*GaussianTensors(*some), frames, PIXELS, PIXELS, Projector())

    def divided_rays(*some: torch.Tensor) -> torch.Tensor:
        return rasterize_divided(DividedTensors(*some), frames, (PIXELS, PIXELS), Projector(cutoff=4.0))

    def plain_voxels(*some: torch.Tensor) -> torch.Tensor:
        return voxelize_tensor(*GaussianTensors(*some), grid)

    def divided_voxels(*some: torch.Tensor) -> torch.Tensor:
        return voxelize_divided(DividedTensors(*some), grid, 4.0)

    def moved(*some: torch.Tensor) -> Values:
        if some[0].device.type == "cpu":
            arrays = [part.numpy().copy() for part in some]
            ascend(arrays[0], arrays[1], mixing, grid, arrays[2], arrays[2])
            return [torch.from_numpy(arrays[0])]
        copy = some[0].clone()
        ascend(copy, some[1], mixing, grid, some[2], some[2])
        return [copy]

    def transposed(some: torch.Tensor) -> Values:
        if some.device.type == "cpu":
            return [torch.from_numpy(gradient(some.numpy(), mixing, grid))]
        return [gradient(some, mixing, grid)]

    def newton(*some: torch.Tensor) -> Values:
        if some[0].device.type == "cpu":
            start, blocks, slopes = (part.numpy() for part in some)
            return [torch.from_numpy(nonnegative_newton_step(start, blocks, slopes))]
        return [nonnegative_newton_step(some[0], some[1], some[2])]

    def of_counts(some: torch.Tensor) -> Values:
        along = some.movedim(-1, 0).contiguous()
        if some.device.type == "cpu":
            found = likelihood(along.numpy(), measured, model, 0.02, True)
            return [torch.from_numpy(np.asarray(part)) for part in found]
        return [part for part in tensors.likelihood(along, measured, model, 0.02, True) if part is not None]

    return {
        "rays of plain Gaussians": (lambda *some: with_gradients(plain_rays, some), plain),
        "rays of divided Gaussians": (lambda *some: with_gradients(divided_rays, some), parts),
        "voxels of plain Gaussians": (lambda *some: with_gradients(plain_voxels, some), plain),
        "voxels of divided Gaussians": (lambda *some: with_gradients(divided_voxels, some), parts),
        "rays of voxels": (lambda some: [project(some, grid, frames.numpy(), PIXELS, PIXELS)], [volumes]),
        "transpose": (lambda some: [project_transpose(some, grid, frames.numpy())], [images]),
        "expected counts": (lambda some: with_gradients(lambda x: transmit(x, model), [some]), [lengths]),
        "likelihood of counts": (of_counts, [lengths]),
        "total variation, ascent": (moved, [field, volumes, steps]),
        "total variation, transpose": (transposed, [field]),
        "non-negative Newton step": (newton, [volumes, inverse, volumes.flip(1).contiguous()]),
    }


def timed(function: Kernel, values: Values) -> tuple[Values, float]:
    """Result, and the least milliseconds of some calls after the first."""
    found, best = function(*values), float("inf")
    on_gpu = values[0].device.type == "cuda"
    for _ in range(REPEATS if on_gpu else 2):
        if on_gpu:
            torch.cuda.synchronize()
        began = time.perf_counter()
        found = function(*values)
        if on_gpu:
            torch.cuda.synchronize()
        best = min(best, 1e3 * (time.perf_counter() - began))
    return found, best


def kernel_rows() -> list[str]:
    """One row of the table for each kernel."""
    rows = []
    for name, (function, values) in kernels().items():
        wanted, slow = timed(function, values)
        found, fast = timed(function, [part.cuda() for part in values])
        errors = [float((a.cpu() - b).double().norm() / b.double().norm()) for a, b in zip(found, wanted, strict=True)]
        value = float((found[0].cpu() - wanted[0]).abs().max() / wanted[0].abs().max())
        worst = f"{max(errors[1:]):.1e}" if len(errors) > 1 else "-"
        rows.append(f"| {name} | {value:.1e} | {worst} | {slow:.1f} | {fast:.2f} | {slow / fast:.0f} |")
        print(rows[-1], flush=True)
    return rows


def tests() -> str:
    """Last line of the tests of the kernels on the GPU."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *TESTS]
    root = Path(__file__).parents[1]
    found = subprocess.run(
        command, env={**os.environ, "TRITON_INTERPRET": "0"}, capture_output=True, text=True, check=False, cwd=root
    )
    failed = [line for line in found.stdout.splitlines() if line.startswith("FAILED")]
    return "; ".join([*failed, found.stdout.strip().splitlines()[-1]])


def fit(dataset: Path, device: str, run: Path) -> dict[str, Any]:
    """Scores and times of a fit by the command line, in this process; memory of the GPU, or of the process."""
    from recon.cli.main import main as recon  # noqa: PLC0415 - only where a fit is wanted

    if device == "cuda":
        torch.cuda.reset_peak_memory_stats()
    began = time.perf_counter()
    options = ["--device", device, "--out", str(run), "--overwrite", "--no-figures"]
    recon.main(["fit", str(dataset), *options], standalone_mode=False)
    whole = time.perf_counter() - began
    metrics = json.loads((run / "metrics.json").read_text(encoding="utf-8"))
    memory = torch.cuda.max_memory_allocated() / 2**30 if device == "cuda" else float("nan")
    return {"whole": whole, "memory": memory, **metrics}


def fit_row(name: str, device: str, found: dict[str, Any]) -> str:
    """One row of the table of fits."""
    seconds = found["seconds"]
    psnr = " / ".join(f"{basis['psnr']:.1f}" for basis in found["basis"].values())
    stages = " ".join(f"{stage} {value:.1f}" for stage, value in seconds.items() if value >= 0.05)
    last = sum(seconds.get(stage, 0.0) for stage in FIT)
    memory = "-" if np.isnan(found["memory"]) else f"{found['memory']:.1f}"
    return f"| {name} | {device} | {psnr} | {last:.1f} | {found['whole']:.1f} | {memory} | {stages} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--without-tests", action="store_true")
    parser.add_argument("--quick", action="store_true")
    asked = parser.parse_args()
    if not torch.cuda.is_available():
        raise SystemExit("python -m benchmarks.gpu needs a GPU and a PyTorch that was built for it")
    print(
        head := f"{torch.cuda.get_device_name()}, {thread_count()} threads of the processor, torch {torch.__version__}"
    )
    lines = ["# On a GPU", "", head, "", "| kernel | value | gradient | CPU [ms] | GPU [ms] | ratio |"]
    lines += ["|---|---|---|---|---|---|", *kernel_rows(), ""]
    TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    if not asked.without_tests:
        lines += [f"Tests of the kernels on the GPU: {tests()}", ""]
    lines += ["| scan | device | PSNR [dB] | fit [s] | command [s] | GPU memory [GiB] | stages [s] |"]
    lines += ["|---|---|---|---|---|---|---|"]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for title, dataset, device in fits(folder, asked.quick):
            lines.append(fit_row(title, device, fit(dataset, device, folder / "run")))
            print(lines[-1], flush=True)
            TABLE.write_text("\n".join(lines) + "\n", encoding="utf-8")


def fits(folder: Path, quick: bool) -> Iterator[tuple[str, Path, str]]:
    """Name, scan and device of each fit; scans are made when their turn comes, and those of the GPU come first."""
    scans = [("kedge-small", "kedge-small", {}), ("kedge", "kedge", {}), ("256^3, 512^2 x 75", "kedge", LARGE)]
    scans = scans[:1] if quick else scans
    for number, (title, preset, changes) in enumerate(scans):
        phantomgen.make(phantomgen.load(preset, changes), folder / f"{number}.h5").close()
        if number == 0:
            yield f"{title}, first", folder / "0.h5", "cuda"
        yield title, folder / f"{number}.h5", "cuda"
    for number, (title, _, _) in enumerate(scans):
        yield title, folder / f"{number}.h5", "cpu"


if __name__ == "__main__":
    main()
