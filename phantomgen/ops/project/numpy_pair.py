"""The projector pair for numpy arrays: numba kernels, shared out between threads by views and by layers of voxels."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32

from phantomgen.ops.project import cpu, z_aligned
from spectra.threads import run_parallel

_LAYERS = 32  # of z per piece of work of the transpose
_MOST_LANES = 4  # components that are computed together; each number is compiled of its own


def forward(
    volume: Float[np.ndarray, "component z y x"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[np.ndarray, "component view row column"]:
    """Line integrals; frames in voxels and sizes of voxels [mm] in the order (z, y, x)."""
    stacked = _are_z_aligned(views, rows, columns, parallel)
    volume = np.asarray(volume, dtype=np.float32)
    components, *shape = volume.shape
    strides = _strides(shape)
    flat = np.ascontiguousarray(volume).reshape(components, -1) if not stacked.all() else None
    groups = _lines_side_by_side(volume) if stacked.any() else []
    out = np.zeros((len(views), components, rows, columns), dtype=np.float32)

    def view(i: int) -> None:
        if not stacked[i]:
            cpu.forward(flat, views[i], parallel, spacing, strides, _room(shape, components), out[i])
            return
        for group, lanes, lines in groups:
            image = np.zeros((columns, rows * len(lanes)), dtype=np.float32)
            room, drawing = _room_for_lines(shape, rows, len(lanes), shape[0]), _room_for_pictures(shape, len(lanes))
            z_aligned.forward(lanes, lines, views[i], parallel, spacing, strides[0], room, drawing, image)
            out[i, group] = image.reshape(columns, rows, len(lanes)).T

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
    stacked = _are_z_aligned(views, rows, columns, parallel)
    out = np.zeros((components, *shape), dtype=np.float32)
    flat, strides = out.reshape(components, -1), _strides(shape)
    upright_views, groups = views[stacked], _columns_side_by_side(images[stacked]) if stacked.any() else []

    def piece(first: int) -> None:
        last = min(first + _LAYERS, shape[0]) - 1
        for image, view in zip(images[~stacked], views[~stacked], strict=True):
            cpu.backward(image, view, parallel, spacing, strides, first, last, _room(shape, components), flat)
        for group, lanes, beside in groups:
            layers = _upright_layers(lanes, beside, upright_views, parallel, spacing, shape, first, last)
            out[group, first : last + 1] += layers

    for _ in run_parallel(piece, range(0, shape[0], _LAYERS)):
        pass
    return out


def _groups(components: int) -> list[tuple[slice, tuple[np.float32, ...]]]:
    """Which components are computed together, in groups as even as can be, and lanes for them."""
    count = -(-components // _MOST_LANES)
    ends = [i * components // count for i in range(count + 1)]
    return [(slice(a, b), (np.float32(0),) * (b - a)) for a, b in pairwise(ends)]


def _lines_side_by_side(
    volume: Float32[np.ndarray, "component z y x"],
) -> list[tuple[slice, tuple[np.float32, ...], Float32[np.ndarray, "y x_and_one number"]]]:
    """Groups of components, their lanes, and their lines along z.

    One x more than there are keeps lines of different y from the same sets of the cache.
    """
    components, depth, height, width = volume.shape
    found = []
    for group, lanes in _groups(components):
        lines = np.zeros((height, width + 1, depth, len(lanes)), dtype=np.float32)
        lines[:, :width] = volume[group].transpose(2, 3, 1, 0)
        found.append((group, lanes, lines.reshape(height, width + 1, -1)))
    return found


def _columns_side_by_side(
    images: Float32[np.ndarray, "view component row column"],
) -> list[tuple[slice, tuple[np.float32, ...], Float32[np.ndarray, "view column number"]]]:
    """Groups of components, their lanes, and their columns."""
    views, components, _, columns = images.shape
    found = []
    for group, lanes in _groups(components):
        beside = np.ascontiguousarray(images[:, group].transpose(0, 3, 2, 1))
        found.append((group, lanes, beside.reshape(views, columns, -1)))
    return found


def _upright_layers(
    lanes: tuple[np.float32, ...],
    images: Float32[np.ndarray, "view column number"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    shape: tuple[int, int, int],
    first: int,
    last: int,
) -> Float32[np.ndarray, "lane layer y x"]:
    """What views whose rows are stacked give to some layers."""
    (_, height, width), layers, rows = shape, last - first + 1, images.shape[2] // len(lanes)
    volume = np.zeros((height, width + 1, layers * len(lanes)), dtype=np.float32)  # as in `_lines_side_by_side`
    room, narrow = _room_for_lines(shape, rows, len(lanes), layers), _room_for_beams(rows, len(lanes), layers)
    numbers = _strides(shape)[0]
    for image, view in zip(images, views, strict=True):
        z_aligned.backward(lanes, image, view, parallel, spacing, numbers, first, last, room, narrow, volume)
    return np.moveaxis(volume.reshape(height, width + 1, layers, len(lanes))[:, :width], (3, 2), (0, 1))


def _strides(shape: Sequence[int]) -> np.ndarray:
    """How many voxels along (z, y, x), and how far apart in memory."""
    z, y, x = shape
    return np.array([[z, y, x], [y * x, x, 1]])


def _room(shape: Sequence[int], components: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Scratch of a kernel."""
    return np.empty(7), np.empty((2, max(shape))), np.empty(components)


def _room_for_lines(shape: Sequence[int], rows: int, lanes: int, layers: int) -> tuple[np.ndarray, ...]:
    """Scratch of a kernel that works on lines along z."""
    lines = np.empty((2, layers + 1, lanes))
    return np.empty(7), np.empty(max(shape)), np.empty((4, rows)), lines[0], lines[1]


def _room_for_beams(rows: int, lanes: int, layers: int) -> tuple[np.ndarray, np.ndarray]:
    """Scratch of `z_aligned.backward` for beams up to two voxels wide."""
    return np.empty((4, rows)), np.empty((layers + z_aligned.PADDING) * lanes, dtype=np.float32)


def _room_for_pictures(shape: Sequence[int], lanes: int) -> tuple[np.ndarray, ...]:
    """Scratch of `z_aligned.forward` for lines that are summed together."""
    most = max(shape[1:])
    pictures = np.zeros((most, (shape[0] + z_aligned.PADDING) * lanes), dtype=np.float32)
    steps, sizes = np.empty((2, most), dtype=np.float32)
    return pictures, steps, sizes, np.empty((3, most + 1), dtype=np.float32), np.empty(most + 1, dtype=np.int32)


def _are_z_aligned(
    views: Float[np.ndarray, "view 4 3"], rows: int, columns: int, parallel: bool
) -> Bool[np.ndarray, " view"]:
    """Views, in voxels, whose rows differ along z only and whose rays all rise by less than they advance."""
    first, last = (views[:, 0], views[:, 0]) if parallel else (views[:, 1], views[:, 1] + (rows - 1) * views[:, 3])
    across = 0.0 if parallel else np.arange(columns)[:, None, None] * views[:, 2]
    rise = np.maximum(np.abs(first + across)[..., 0], np.abs(last + across)[..., 0])
    advance = np.abs(first + across)[..., 1:].max(axis=-1)
    z_aligned = ~views[:, 3, 1:].any(axis=-1)
    return np.logical_and(z_aligned, np.atleast_2d(rise < advance).all(axis=0))
