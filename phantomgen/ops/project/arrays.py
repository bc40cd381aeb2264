"""The projector pair for numpy arrays: numba kernels, shared out between threads by views and by layers of voxels."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Float32

from phantomgen.ops.project import cpu, upright
from spectra.threads import run_parallel

_LAYERS = 32  # of z per piece of work of the transpose


def forward(
    volume: Float[np.ndarray, "component z y x"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[np.ndarray, "component view row column"]:
    """Line integrals; frames in voxels and sizes of voxels [mm] in the order (z, y, x)."""
    stacked = _are_upright(views, rows, columns, parallel)
    volume = np.asarray(volume, dtype=np.float32)
    components, *shape = volume.shape
    strides = _strides(shape)
    flat = np.ascontiguousarray(volume).reshape(components, -1) if not stacked.all() else None
    lines = np.ascontiguousarray(np.moveaxis(volume, 1, -1)) if stacked.any() else None
    out = np.zeros((len(views), components, rows, columns), dtype=np.float32)

    def view(i: int) -> None:
        if stacked[i]:
            room = _room_for_lines(shape, rows, components, shape[0])
            drawing = _room_for_pictures(shape, components)
            upright.forward(lines, views[i], parallel, spacing, strides[0], room, drawing, out[i])
        else:
            cpu.forward(flat, views[i], parallel, spacing, strides, _room(shape, components), out[i])

    for _ in run_parallel(view, range(len(views))):
        pass
    return np.ascontiguousarray(np.moveaxis(out, 0, 1))


def backward(
    images: Float[np.ndarray, "component view row column"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    shape: tuple[int, int, int],
) -> Float32[np.ndarray, "component z y x"]:
    """Transpose of `forward`."""
    components, _, rows, columns = images.shape
    images = np.ascontiguousarray(np.moveaxis(images, 1, 0), dtype=np.float32)
    stacked = _are_upright(views, rows, columns, parallel)
    out = np.zeros((components, *shape), dtype=np.float32)
    flat, strides, (depth, height, width) = out.reshape(components, -1), _strides(shape), shape

    def piece(first: int) -> None:
        last = min(first + _LAYERS, depth) - 1
        lines = np.zeros((components, height, width, last - first + 1), dtype=np.float32)
        for image, view, is_stacked in zip(images, views, stacked, strict=True):
            if is_stacked:
                room = _room_for_lines(shape, rows, components, last - first + 1)
                narrow = _room_for_columns(rows, components, last - first + 1)
                upright.backward(image, view, parallel, spacing, strides[0], first, last, room, narrow, lines)
            else:
                room = _room(shape, components)
                cpu.backward(image, view, parallel, spacing, strides, first, last, room, flat)
        out[:, first : last + 1] += np.moveaxis(lines, -1, 1)

    for _ in run_parallel(piece, range(0, depth, _LAYERS)):
        pass
    return out


def _strides(shape: Sequence[int]) -> np.ndarray:
    """How many voxels along (z, y, x), and how far apart in memory."""
    z, y, x = shape
    return np.array([[z, y, x], [y * x, x, 1]])


def _room(shape: Sequence[int], components: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scratch of a kernel."""
    return np.empty(7), np.empty((2, max(shape))), np.empty(components)


def _room_for_lines(shape: Sequence[int], rows: int, components: int, layers: int) -> tuple[np.ndarray, ...]:
    """Scratch of a kernel that works on lines along z."""
    lines = np.empty((2, components, layers + 1))
    return np.empty(7), np.empty(max(shape)), np.empty((4, rows)), lines[0], lines[1]


def _room_for_columns(rows: int, components: int, layers: int) -> tuple[np.ndarray, np.ndarray]:
    """Scratch of `upright.backward` for beams up to two voxels wide."""
    lines = np.empty((components, layers + upright.PADDING), dtype=np.float32)
    return np.empty((components, rows), dtype=np.float32), lines


def _room_for_pictures(shape: Sequence[int], components: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scratch of `upright.forward` for lines that are summed together."""
    most = max(shape[1:])
    pictures = np.zeros((components, most, shape[0] + upright.PADDING), dtype=np.float32)
    steps, sizes = np.empty((2, most), dtype=np.float32)
    return pictures, steps, sizes


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
