"""The projector pair for numpy arrays: numba kernels, shared out between threads by views and by layers of voxels."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32

from phantomgen.ops.project import cpu, one_slice, pose_derivatives, z_aligned
from spectra.threads import run_parallel, thread_count

# Most layers of z per piece of work of the transpose; changes time, not results.
_MOST_LAYERS = 64
# Parts of the views whose sums the transpose of one slice takes side by side; as many whatever the threads.
_PARTS = 8
# Most components that are computed together; kernels are compiled once for each number of them.
_MOST_LANES = 4


def forward(
    volume: Float[np.ndarray, "component z y x"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[np.ndarray, "component view row column"]:
    """Compute line integrals of volumes.

    Parameters
    ----------
    volume : values of the voxels
    views : frames in voxels and in the order (z, y, x), as in `phantomgen.ops.project.project`
    parallel : whether rays are parallel
    spacing : size of a voxel (z, y, x) [mm]
    rows, columns : size of the panel

    Returns
    -------
    line integrals
    """
    stacked = _are_z_aligned(views, rows, columns, parallel)
    volume = np.asarray(volume, dtype=np.float32)
    if volume.shape[1] == rows == 1 and stacked.all():
        return _forward_slice(volume, _seen(views, parallel, spacing, volume.shape[1:]), columns)
    components, *shape = volume.shape
    strides = _strides(shape)
    flat = np.ascontiguousarray(volume).reshape(components, -1) if not stacked.all() else None
    groups = _lines_side_by_side(volume) if stacked.any() else []
    out = np.zeros((len(views), components, rows, columns), dtype=np.float32)

    def view(i: int) -> None:
        seen = cpu.VoxelView(views[i], parallel, spacing, strides)
        if not stacked[i]:
            cpu.forward(flat, seen, cpu.BeamScratch.of(shape, components), out[i])
            return
        for group, lanes, lines in groups:
            image = np.zeros((columns, rows * len(lanes)), dtype=np.float32)
            scratch = z_aligned.ColumnScratch.of(shape, rows, len(lanes), shape[0])
            z_aligned.forward(lanes, lines, seen, scratch, z_aligned.PictureScratch.of(shape, len(lanes)), image)
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
    """Apply the transpose of `forward`.

    Parameters
    ----------
    images : values of the pixels
    views, parallel, spacing : as in `forward`
    shape : number of voxels along (z, y, x)

    Returns
    -------
    volumes
    """
    components, _, rows, columns = images.shape
    images = np.ascontiguousarray(np.moveaxis(images, 1, 0), dtype=np.float32)
    stacked = _are_z_aligned(views, rows, columns, parallel)
    if shape[0] == rows == 1 and stacked.all():
        return _backward_slice(images, _seen(views, parallel, spacing, shape), shape)
    out = np.zeros((components, *shape), dtype=np.float32)
    flat, strides = out.reshape(components, -1), _strides(shape)
    z_aligned_views = _seen(views[stacked], parallel, spacing, shape)
    groups = _columns_side_by_side(images[stacked]) if stacked.any() else []

    def piece(ends: tuple[int, int]) -> None:
        first, last = ends[0], ends[1] - 1
        for image, view in zip(images[~stacked], views[~stacked], strict=True):
            seen = cpu.VoxelView(view, parallel, spacing, strides)
            cpu.backward(image, seen, first, last, cpu.BeamScratch.of(shape, components), flat)
        for group, lanes, beside in groups:
            layers = _z_aligned_layers(lanes, beside, z_aligned_views, (first, last))
            out[group, first : last + 1] += layers

    for _ in run_parallel(piece, _even_pieces(shape[0])):
        pass
    return out


def pose_gradient(
    volume: Float[np.ndarray, "component z y x"],
    images: Float[np.ndarray, "component view row column"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
) -> Float[np.ndarray, "view 4 3"]:
    """Compute the derivatives of ``(images * forward(volume, ...)).sum()`` in the views.

    Parameters
    ----------
    volume : values of the voxels
    images : weights of the pixels
    views, parallel, spacing : as in `forward`

    Returns
    -------
    derivatives [1/voxel]
    """
    components, *shape = volume.shape
    flat = np.ascontiguousarray(volume.reshape(components, -1).T, dtype=np.float32)
    weights = np.ascontiguousarray(np.moveaxis(images, 0, -1), dtype=np.float64)
    strides, out = _strides(shape), np.zeros((len(views), 4, 3))

    def view(i: int) -> None:
        seen = cpu.VoxelView(views[i], parallel, spacing, strides)
        pose_derivatives.pose_derivatives(flat, weights[i], seen, pose_derivatives.PoseScratch.of(shape), out[i])

    for _ in run_parallel(view, range(len(views))):
        pass
    return out


def _even_pieces(layers: int) -> list[tuple[int, int]]:
    """First layers, and ones past the last, of pieces that keep all threads busy for as long."""
    threads = thread_count()
    count = max(min(threads * -(-layers // (threads * _MOST_LAYERS)), layers), 1)
    return list(pairwise(i * layers // count for i in range(count + 1)))


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


def _z_aligned_layers(
    lanes: tuple[np.float32, ...],
    images: Float32[np.ndarray, "view column number"],
    views: list[cpu.VoxelView],
    ends: tuple[int, int],
) -> Float32[np.ndarray, "lane layer y x"]:
    """Sum over views whose rows are stacked, in the layers from the first to the last one of `ends`."""
    first, last = ends
    shape, layers, rows = views[0].strides[0].tolist(), last - first + 1, images.shape[2] // len(lanes)
    _, height, width = shape
    volume = np.zeros((height, width + 1, layers * len(lanes)), dtype=np.float32)  # as in `_lines_side_by_side`
    scratch = z_aligned.ColumnScratch.of(shape, rows, len(lanes), layers)
    narrow = z_aligned.LineScratch.of(rows, len(lanes), layers)
    for image, view in zip(images, views, strict=True):
        z_aligned.backward(lanes, image, view, first, last, scratch, narrow, volume)
    return np.moveaxis(volume.reshape(height, width + 1, layers, len(lanes))[:, :width], (3, 2), (0, 1))


def _forward_slice(
    volume: Float32[np.ndarray, "component 1 y x"], views: list[cpu.VoxelView], columns: int
) -> Float32[np.ndarray, "component view 1 column"]:
    """Compute line integrals of one slice, for one row of pixels."""
    out = np.empty((len(volume), len(views), 1, columns), dtype=np.float32)
    ends = ((0, 0), (0, one_slice.PADDING), (0, 0))
    for group, lanes in _groups(len(volume)):
        voxels = np.moveaxis(volume[group, 0], 0, -1)
        along_x, along_y = (np.pad(lines, ends).reshape(-1) for lines in (voxels, voxels.swapaxes(0, 1)))

        def view(i: int, lanes=lanes, group=group, along_x=along_x, along_y=along_y) -> None:
            image = np.empty(columns * len(lanes), dtype=np.float32)
            scratch = one_slice.SliceScratch.of(volume.shape[1:])
            one_slice.forward(lanes, along_x, along_y, views[i], scratch, image)
            out[group, i, 0] = image.reshape(columns, -1).T

        for _ in run_parallel(view, range(len(views))):
            pass
    return out


def _backward_slice(
    images: Float32[np.ndarray, "view component 1 column"], views: list[cpu.VoxelView], shape: tuple[int, int, int]
) -> Float32[np.ndarray, "component 1 y x"]:
    """Sum one row of pixels in one slice."""
    _, height, width = shape
    out = np.zeros((images.shape[1], *shape), dtype=np.float32)
    pieces = [part for part in np.array_split(np.arange(len(views)), _PARTS) if len(part)]
    for group, lanes, beside in _columns_side_by_side(images):

        def piece(part: np.ndarray, lanes=lanes, beside=beside) -> Float32[np.ndarray, "lane y x"]:
            along_x, along_y = (
                np.zeros((lines, voxels + one_slice.PADDING, len(lanes)), dtype=np.float32)
                for lines, voxels in ((height, width), (width, height))
            )
            scratch = one_slice.SliceScratch.of(shape)
            for i in part:
                one_slice.backward(
                    lanes, beside[i].reshape(-1), views[i], scratch, along_x.reshape(-1), along_y.reshape(-1)
                )
            return np.moveaxis(along_x[:, :width] + along_y[:, :height].swapaxes(0, 1), -1, 0)

        for summed in run_parallel(piece, pieces):
            out[group, 0] += summed
    return out


def _seen(
    views: Float[np.ndarray, "view 4 3"], parallel: bool, spacing: Float[np.ndarray, " 3"], shape: Sequence[int]
) -> list[cpu.VoxelView]:
    """Views of a grid."""
    strides = _strides(shape)
    return [cpu.VoxelView(view, parallel, spacing, strides) for view in views]


def _strides(shape: Sequence[int]) -> np.ndarray:
    """How many voxels along (z, y, x), and how far apart in memory."""
    z, y, x = shape
    return np.array([[z, y, x], [y * x, x, 1]])


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
