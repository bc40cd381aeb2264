"""Time of the voxel projector and of its gradients in the poses, and the error of these gradients.

python -m benchmarks.operators.pose_gradient
"""

import time
from collections.abc import Callable

import numpy as np
import torch

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import pose_gradient, project_transpose
from phantomgen.ops.project import project as project_arrays
from phantomgen.torch import TensorGeometry, project
from spectra.threads import set_threads

VOXELS, PIXELS, VIEWS = 48, 96, 12


def seconds(call: Callable[[], object], repeats: int = 3) -> float:
    call()
    begin = time.perf_counter()
    for _ in range(repeats):
        call()
    return (time.perf_counter() - begin) / repeats


def main() -> None:
    set_threads(1)
    torch.set_num_threads(1)
    grid, rng = Grid.cube(VOXELS, 128.0), np.random.default_rng(0)
    angles = np.linspace(0, 2 * np.pi, VIEWS, endpoint=False)
    geometry = Geometry.circular(600.0, 1000.0, angles, Panel(PIXELS, PIXELS, 2.4))
    volume = rng.random((3, *grid.shape), dtype=np.float32)
    images = rng.random((3, VIEWS, PIXELS, PIXELS), dtype=np.float32)
    frames, gradients = geometry.ray_frames(), []

    def by_plain_torch() -> None:
        poses = TensorGeometry.of(geometry)
        poses.source.requires_grad_()
        values = torch.from_numpy(volume).double().requires_grad_()
        (project(values, grid, poses) * torch.from_numpy(images)).sum().backward()
        gradients[:] = [poses.source.grad]

    print(f"{VOXELS}^3 voxels, 3 volumes, {VIEWS} views of {PIXELS}^2 pixels, one thread")
    print(f"line integrals       {seconds(lambda: project_arrays(volume, grid, frames, PIXELS, PIXELS)):7.3f} s")
    print(f"transpose            {seconds(lambda: project_transpose(images, grid, frames)):7.3f} s")
    print(f"gradient in poses    {seconds(lambda: pose_gradient(volume, images, grid, frames)):7.3f} s")
    print(f"plain torch, float64 {seconds(by_plain_torch, 1):7.3f} s for line integrals and all gradients")
    by_frame = pose_gradient(volume, images, grid, frames)
    by_source = by_frame[:, 0] - by_frame[:, 1]  # the second vector of a frame begins at the source
    error = np.abs(by_source - gradients[0].numpy()).max() / np.abs(by_source).max()
    print(f"largest difference of the gradients in the sources {error:.1e} of the largest")


if __name__ == "__main__":
    main()
