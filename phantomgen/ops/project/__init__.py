"""Line integrals of voxel volumes, and the exact transpose: a matched pair for any flat panel, cone or parallel.

Of the projectors that were compared (`benchmarks/voxel_projector.py`), this one errs least per time: where pixels are
no wider than voxels it is Joseph's, and wider pixels are averaged over their area.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32

from phantomgen.grid import Grid
from spectra.errors import InputError
from spectra.threads import run_parallel

_LAYERS = 32  # of z per piece of work of the transpose


def project(
    volume: Float[np.ndarray, "component z y x"],
    grid: Grid,
    frames: Float[np.ndarray, "view 4 3"],
    rows: int,
    columns: int,
    parallel: bool = False,
) -> Float32[np.ndarray, "component view row column"]:
    """Line integrals of several volumes at once; [1/mm] gives numbers without unit.

    Parameters
    ----------
    volume : values of the voxels; there is nothing outside of the grid
    grid : the voxels
    frames : per view, as `Geometry.ray_frames` gives them, of rays ``frame[0] + t (frame[1] + u frame[2] + v
        frame[3])`` through column u and row v [mm]; if `parallel`, of rays ``frame[1] + u frame[2] + v frame[3] + t
        frame[0]``. Rays begin at t = 0, the source, and end at t = 1, the panel.
    rows, columns : size of the panel
    parallel : which of the two
    """
    from phantomgen.ops.project import cpu, upright  # noqa: PLC0415 - numba is only worth its import where it computes

    if volume.shape[1:] != grid.shape:
        raise InputError(f"a volume on a grid of shape {grid.shape} must end with these axes, got {volume.shape}")
    views, spacing, strides = _in_voxels(frames, grid, parallel)
    stacked = _are_upright(views, rows, columns, parallel)
    volume = np.asarray(volume, dtype=np.float32)
    flat = np.ascontiguousarray(volume).reshape(len(volume), -1) if not stacked.all() else None
    lines = np.ascontiguousarray(np.moveaxis(volume, 1, -1)) if stacked.any() else None
    out = np.zeros((len(views), len(volume), rows, columns), dtype=np.float32)

    def view(i: int) -> None:
        if stacked[i]:
            room = _room_for_lines(grid, rows, len(volume), grid.shape[0])
            upright.forward(lines, views[i], bool(parallel), spacing, strides[0], room, out[i])
        else:
            cpu.forward(flat, views[i], bool(parallel), spacing, strides, _room(grid, len(volume)), out[i])

    for _ in run_parallel(view, range(len(views))):
        pass
    return np.ascontiguousarray(np.moveaxis(out, 0, 1))


def project_transpose(
    images: Float[np.ndarray, "component view row column"],
    grid: Grid,
    frames: Float[np.ndarray, "view 4 3"],
    parallel: bool = False,
) -> Float32[np.ndarray, "component z y x"]:
    """Sum of all pixels, each times the weight that `project` gives to a voxel [mm]; parameters as there."""
    from phantomgen.ops.project import cpu, upright  # noqa: PLC0415

    if images.ndim != 4 or images.shape[1] != len(frames):
        raise InputError(f"images of {len(frames)} views must be (component, view, row, column), got {images.shape}")
    components, _, rows, columns = images.shape
    images = np.ascontiguousarray(np.moveaxis(images, 1, 0), dtype=np.float32)
    views, spacing, strides = _in_voxels(frames, grid, parallel)
    stacked = _are_upright(views, rows, columns, parallel)
    out = np.zeros((components, *grid.shape), dtype=np.float32)
    flat, (depth, height, width) = out.reshape(components, -1), grid.shape

    def piece(first: int) -> None:
        last = min(first + _LAYERS, depth) - 1
        lines = np.zeros((components, height, width, last - first + 1), dtype=np.float32)
        for image, view, is_stacked in zip(images, views, stacked, strict=True):
            if is_stacked:
                room = _room_for_lines(grid, rows, components, last - first + 1)
                upright.backward(image, view, bool(parallel), spacing, strides[0], first, last, room, lines)
            else:
                room = _room(grid, components)
                cpu.backward(image, view, bool(parallel), spacing, strides, first, last, room, flat)
        out[:, first : last + 1] += np.moveaxis(lines, -1, 1)

    for _ in run_parallel(piece, range(0, depth, _LAYERS)):
        pass
    return out


def _in_voxels(frames: np.ndarray, grid: Grid, parallel: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames in voxels and in the order (z, y, x), sizes of voxels [mm], and how many there are and how far apart."""
    frames = np.array(frames, dtype=np.float64)
    if frames.ndim != 3 or frames.shape[1:] != (4, 3) or not np.isfinite(frames).all():
        raise InputError(f"frames must be four finite vectors per view, (view, 4, 3), got {frames.shape}")
    frames[:, int(parallel)] -= grid.origin[::-1]
    spacing, (z, y, x) = np.array(grid.spacing, dtype=np.float64), grid.shape
    strides = np.array([[z, y, x], [y * x, x, 1]])
    return np.ascontiguousarray(frames[:, :, ::-1] / spacing), spacing, strides


def _room(grid: Grid, components: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scratch of a kernel."""
    return np.empty(7), np.empty((2, max(grid.shape))), np.empty(components)


def _room_for_lines(grid: Grid, rows: int, components: int, layers: int) -> tuple[np.ndarray, ...]:
    """Scratch of a kernel that works on lines along z."""
    lines = np.empty((2, components, layers + 1))
    return np.empty(7), np.empty(max(grid.shape)), np.empty((4, rows)), lines[0], lines[1]


def _are_upright(
    views: Float[np.ndarray, "view 4 3"], rows: int, columns: int, parallel: bool
) -> Bool[np.ndarray, " view"]:
    """Views, in voxels, whose rows differ along z only and whose rays all rise by less than they advance."""
    first, last = (views[:, 0], views[:, 0]) if parallel else (views[:, 1], views[:, 1] + (rows - 1) * views[:, 3])
    across = 0.0 if parallel else np.arange(columns)[:, None, None] * views[:, 2]
    rise = np.maximum(np.abs(first + across)[..., 0], np.abs(last + across)[..., 0])
    advance = np.abs(first + across)[..., 1:].max(axis=-1)
    upright = ~views[:, 3, 1:].any(axis=-1)
    return np.logical_and(upright, np.atleast_2d(rise < advance).all(axis=0))
