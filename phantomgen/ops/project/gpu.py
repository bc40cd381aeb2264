"""Voxel projector and its transpose in Triton, with the weights of `phantomgen.ops.project.cpu`.

Both directions gather: a pixel from the voxels that its beam meets, a voxel from the pixels whose beams may meet it. So
nothing is added atomically, and results repeat bit by bit. The tests compile the kernels for GPUs but run them in
Triton's interpreter; on a GPU, `benchmarks/operators/voxel_projector.py --device cuda` times them and compares them
with numba.
"""

from collections.abc import Iterator
from typing import no_type_check

import numpy as np
import torch
import triton
import triton.language as tl
from jaxtyping import Float, Float32
from torch import Tensor

from phantomgen.ops.project.ray_table import RayTable, ray_table

# Most rays in a table at a time: 12 numbers of 4 bytes each, 50 MB.
_RAYS = 2**20
# Most views of a launch, which CUDA limits to 65535 along its second axis.
_VIEWS = 2**15
# Pixels or voxels per program, and most components; change time, not results.
_BLOCK, _COMPONENTS = 128, 4


@triton.jit
@no_type_check
def _field(table, i, rays, ray, known):
    """Field i of some rays of a view; see `RayTable`."""
    return tl.load(table + i * rays + ray, mask=known, other=1.0)


@triton.jit
@no_type_check
def _crossing(layer, near, far):
    """Which part of a layer a ray that exists from `near` to `far` crosses, and the middle of that part."""
    low, high = tl.maximum(layer - 0.5, near), tl.minimum(layer + 0.5, far)
    return tl.maximum(high - low, 0.0), 0.5 * (low + high)


@triton.jit
@no_type_check
def _beam(off, size, growth, place, slope, wide):
    """Centre of a beam, and its width, some layers off the middle of the grid."""
    return place + off * slope, tl.maximum((size + off * growth) * wide, 1.0)


@triton.jit
@no_type_check
def _share(centre, width, voxel):
    """Which part of a beam lies in a voxel."""
    past, before = tl.minimum(centre + 0.5 * width, voxel + 0.5), tl.maximum(centre - 0.5 * width, voxel - 0.5)
    return tl.maximum(past - before, 0.0) / width


@triton.jit
@no_type_check
def _first(centre, width):
    """First voxel that a beam meets; beams beside the grid may be farther from it than integers reach."""
    return tl.floor(tl.minimum(tl.maximum(centre - 0.5 * width + 0.5, -1e6), 1e6)).to(tl.int32)


@triton.jit
@no_type_check
def _forward(
    table, volume, out, out_stride, rays, components, depth, height, width, plane, voxels,
    TAPS_A: tl.constexpr, TAPS_B: tl.constexpr, BLOCK: tl.constexpr, COMPONENTS: tl.constexpr,
):  # fmt: skip
    """Line integrals (component, view, ray) of volumes (component, voxel): a block of one view's rays."""
    view, ray = tl.program_id(1), tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    component = (tl.program_id(2) * COMPONENTS + tl.arange(0, COMPONENTS)).to(tl.int64)[:, None]
    known, wanted = ray < rays, component < components
    table += view * 12 * rays
    axis, length = _field(table, 0, rays, ray, known), _field(table, 11, rays, ray, known)
    near, far = _field(table, 1, rays, ray, known), _field(table, 2, rays, ray, known)
    size, growth = _field(table, 3, rays, ray, known), _field(table, 4, rays, ray, known)
    place_a, place_b = _field(table, 5, rays, ray, known), _field(table, 8, rays, ray, known)
    slope_a, slope_b = _field(table, 6, rays, ray, known), _field(table, 9, rays, ray, known)
    wide_a, wide_b = _field(table, 7, rays, ray, known), _field(table, 10, rays, ray, known)

    layers = tl.where(axis == 0, depth, tl.where(axis == 1, height, width))
    most_a, most_b = tl.where(axis == 0, height, depth), tl.where(axis == 2, height, width)
    stride = tl.where(axis == 0, plane, tl.where(axis == 1, width, 1)).to(tl.int64)
    stride_a, stride_b = tl.where(axis == 0, width, plane).to(tl.int64), tl.where(axis == 2, width, 1).to(tl.int64)
    volume += component * voxels
    total = tl.zeros((COMPONENTS, BLOCK), dtype=tl.float32)
    for layer in range(tl.max(layers)):
        part, at = _crossing(layer, near, far)
        off = at - 0.5 * (layers - 1)
        beam_a, width_a = _beam(off, size, growth, place_a, slope_a, wide_a)
        beam_b, width_b = _beam(off, size, growth, place_b, slope_b, wide_b)
        first_a, first_b = _first(beam_a, width_a), _first(beam_b, width_b)
        met = known & (layer < layers) & (part > 0.0)
        for i in range(TAPS_A):
            a = first_a + i
            met_a, part_a = met & (a >= 0) & (a < most_a), part * _share(beam_a, width_a, a)
            for j in range(TAPS_B):
                b = first_b + j
                inside, weight = met_a & (b >= 0) & (b < most_b), part_a * _share(beam_b, width_b, b)
                voxel = layer * stride + a * stride_a + b * stride_b
                total += weight[None] * tl.load(volume + voxel[None], mask=wanted & inside[None], other=0.0)
    tl.store(out + component * out_stride + view * rays + ray[None], total * length[None], mask=wanted & known[None])


@triton.jit
@no_type_check
def _linear(row, z, y, x):
    """A row of a matrix (.., 4) times (z, y, x, 1)."""
    return tl.load(row) * z + tl.load(row + 1) * y + tl.load(row + 2) * x + tl.load(row + 3)


@triton.jit
@no_type_check
def _between(least, most, front, behind, count):
    """First pixel, and how many, between two places; all of `count` if not all in `front`, none if all `behind`."""
    first = tl.where(front, tl.ceil(tl.minimum(tl.maximum(least, 0.0), count)), 0.0).to(tl.int32)
    last = tl.where(front, tl.floor(tl.minimum(tl.maximum(most, -1.0), count - 1.0)), count - 1.0).to(tl.int32)
    return first, tl.where(behind, 0, last - first + 1)


@triton.jit
@no_type_check
def _pixels_near(inverse, reach, z, y, x, rows, columns):
    """First row, how many, first column, how many, of the rays that may pass a voxel within `reach`.

    The shadow of a box lies between those of its corners, if all of these are in front of the source.
    """
    least_w, most_w, least_u, most_u, least_v, most_v = 1e30, -1e30, 1e30, -1e30, 1e30, -1e30
    for corner in tl.static_range(8):
        at_z = z + (2 * (corner // 4) - 1) * tl.load(reach)
        at_y = y + (2 * (corner // 2 % 2) - 1) * tl.load(reach + 1)
        at_x = x + (2 * (corner % 2) - 1) * tl.load(reach + 2)
        w = _linear(inverse, at_z, at_y, at_x)
        least_w, most_w = tl.minimum(w, least_w), tl.maximum(w, most_w)
        scale = 1.0 / tl.where(w > 0.0, w, 1.0)
        u, v = scale * _linear(inverse + 4, at_z, at_y, at_x), scale * _linear(inverse + 8, at_z, at_y, at_x)
        least_u, most_u = tl.minimum(u, least_u), tl.maximum(u, most_u)
        least_v, most_v = tl.minimum(v, least_v), tl.maximum(v, most_v)
    front, behind = least_w > 0.0, most_w < 0.0
    row, row_count = _between(least_v, most_v, front, behind, rows)
    column, column_count = _between(least_u, most_u, front, behind, columns)
    return row, row_count, column, column_count


@triton.jit
@no_type_check
def _weight(table, rays, ray, known, layer, a, b, layers):
    """Weight of voxels [mm], given by their layer and place across, in the line integrals of as many rays."""
    part, at = _crossing(layer, _field(table, 1, rays, ray, known), _field(table, 2, rays, ray, known))
    off = at - 0.5 * (layers - 1)
    size, growth = _field(table, 3, rays, ray, known), _field(table, 4, rays, ray, known)
    place, slope = _field(table, 5, rays, ray, known), _field(table, 6, rays, ray, known)
    beam, width = _beam(off, size, growth, place, slope, _field(table, 7, rays, ray, known))
    part *= _share(beam, width, a)
    place, slope = _field(table, 8, rays, ray, known), _field(table, 9, rays, ray, known)
    beam, width = _beam(off, size, growth, place, slope, _field(table, 10, rays, ray, known))
    return part * _share(beam, width, b) * _field(table, 11, rays, ray, known)


@triton.jit
@no_type_check
def _backward(
    table, inverses, reaches, images, images_stride, out,
    views, rows, columns, components, depth, height, width, voxels,
    BLOCK: tl.constexpr, COMPONENTS: tl.constexpr,
):  # fmt: skip
    """Add what images (component, view, ray) give to a block of voxels of volumes (component, voxel)."""
    voxel = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    component = (tl.program_id(1) * COMPONENTS + tl.arange(0, COMPONENTS)).to(tl.int64)[:, None]
    known, wanted, rays = voxel < voxels, component < components, rows * columns
    line, x = voxel // width, (voxel % width).to(tl.int32)
    z, y = (line // height).to(tl.int32), (line % height).to(tl.int32)
    out += component * voxels + voxel[None]
    images += component * images_stride
    total = tl.load(out, mask=wanted & known[None], other=0.0)
    for view in range(views):
        for main in tl.static_range(3):
            reach = reaches + 9 * view + 3 * main
            if tl.load(reach) > 0.0:
                layer, a, b, layers = z, y, x, depth
                if main == 1:
                    layer, a, b, layers = y, z, x, height
                if main == 2:
                    layer, a, b, layers = x, z, y, width
                first_row, row_count, first_column, column_count = _pixels_near(
                    inverses + 12 * view, reach, z, y, x, rows, columns
                )
                of_view = table + view * 12 * rays
                for i in range(tl.max(tl.where(known, row_count, 0))):
                    for j in range(tl.max(tl.where(known, column_count, 0))):
                        ray = (first_row + i) * columns + first_column + j
                        near_it = known & (i < row_count) & (j < column_count)
                        near_it = near_it & (_field(of_view, 0, rays, ray, near_it) == main)
                        weight = _weight(of_view, rays, ray, near_it, layer, a, b, layers)
                        image = tl.load(images + (view * rays + ray)[None], mask=wanted & near_it[None], other=0.0)
                        total += weight[None] * image
    tl.store(out, total, mask=wanted & known[None])


def forward(
    volume: Float32[Tensor, "component z y x"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    rows: int,
    columns: int,
) -> Float32[Tensor, "component view row column"]:
    """Compute line integrals of contiguous volumes.

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
    components, depth, height, width = volume.shape
    out = volume.new_empty((components, len(views), rows, columns))
    for begin, table in _tables(views, parallel, spacing, (depth, height, width), rows, columns, volume.device):
        count, _, rays = table.rays.shape
        of_views = out[:, begin : begin + count]
        block, together = _sizes(components)
        launch = _forward[triton.cdiv(rays, block), count, triton.cdiv(components, together)]
        launch(
            table.rays, volume, of_views, out.stride(0), rays, components, depth, height, width, height * width,
            depth * height * width, *table.taps, block, together,
        )  # fmt: skip
    return out


def backward(
    images: Float32[Tensor, "component view row column"],
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    shape: tuple[int, int, int],
) -> Float32[Tensor, "component z y x"]:
    """Apply the transpose of `forward` to contiguous images.

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
    out = images.new_zeros((components, *shape))
    for begin, table in _tables(views, parallel, spacing, shape, rows, columns, images.device):
        of_views, voxels = images[:, begin : begin + len(table.rays)], out[0].numel()
        block, together = _sizes(components)
        launch = _backward[triton.cdiv(voxels, block), triton.cdiv(components, together)]
        launch(
            table.rays, table.inverses, table.reaches, of_views, images.stride(0), out, len(table.rays), rows, columns,
            components, *shape, voxels, block, together,
        )  # fmt: skip
    return out


def _sizes(components: int) -> tuple[int, int]:
    """Pixels or voxels per program, and components."""
    return _BLOCK, min(_COMPONENTS, triton.next_power_of_2(max(components, 1)))


def _tables(
    views: np.ndarray,
    parallel: bool,
    spacing: np.ndarray,
    shape: tuple[int, int, int],
    rows: int,
    columns: int,
    device: torch.device,
) -> Iterator[tuple[int, RayTable]]:
    """Tables of some views at a time, each with the number of its first view."""
    step = max(1, min(_VIEWS, _RAYS // (rows * columns)))
    for begin in range(0, len(views), step):
        yield begin, ray_table(views[begin : begin + step], parallel, spacing, shape, rows, columns, device)
