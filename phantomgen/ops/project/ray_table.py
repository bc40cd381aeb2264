"""Rays and views for the Triton kernels, computed once in float64 with torch, on the device of the tensors.

Everything that cancels is done here: kernels then count layers from the middle of the grid, where float32 places a ray
to 1e-4 of a voxel in grids of 2000^3 voxels. As both directions read the same table, both give a voxel the same weight.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

# Added to a reach [voxel]; float32 misplaces a voxel on the panel by far less.
_SLACK = 0.01
# Volume spanned by a view's vectors over the product of their lengths, no unit; matrices below are not inverted.
_FLAT = 1e-9


@dataclass(frozen=True, eq=False)
class RayTable:
    """Rays of some views, for the kernels.

    A ray crosses layers of voxels of its main axis; a and b are the other two axes, in the order (z, y, x). Places
    along an axis are voxel indices and may be fractions. A ray's middle is where it meets the middle of the grid, half
    way between the first and the last layer of its main axis.

    Parameters
    ----------
    rays : fields of each ray: 0 main axis; 1 and 2 between which places along it the ray exists; 3 size of its beam in
        the middle, over that at the panel, and 4 what is added per layer; 5 place along a in the middle, 6 what is
        added per layer, 7 width along a at the panel [voxel]; 8 to 10 the same along b; 11 length per layer [mm]
    inverses : matrices that take a voxel (z, y, x, 1) to (w, w u, w v), with (u, v) the column and row of its shadow
        on the panel, and w > 0 in front of the source; zero where a view's vectors lie in a plane
    reaches : per main axis, how far along (z, y, x) a voxel with a part in a beam may lie from the ray, in the middle
        of what the ray crosses of a layer [voxel]; -1 where no ray has this main axis
    taps : how many voxels, along a and along b, a beam may have part in
    """

    rays: Float[Tensor, "view 12 ray"]
    inverses: Float[Tensor, "view 3 4"]
    reaches: Float[Tensor, "view 3 3"]
    taps: tuple[int, int]


def ray_table(
    views: Float[np.ndarray, "view 4 3"],
    parallel: bool,
    spacing: Float[np.ndarray, " 3"],
    shape: tuple[int, int, int],
    rows: int,
    columns: int,
    device: torch.device,
) -> RayTable:
    """Compute the table of all rays of some views.

    Parameters
    ----------
    views : frames in voxels and in the order (z, y, x), as in `phantomgen.ops.project.project`
    parallel : whether rays are parallel
    spacing, shape : size of a voxel [mm] and number of voxels (z, y, x)
    rows, columns : size of the panel
    device : device of the table

    Returns
    -------
    the table
    """
    frames, sizes = torch.tensor(views, device=device), torch.tensor(spacing, device=device)
    u = torch.arange(columns, dtype=torch.float64, device=device)[:, None]
    v = torch.arange(rows, dtype=torch.float64, device=device)[:, None, None]
    fixed, corner, column, row = (frames[:, i, None, None] for i in range(4))
    points = (corner + u * column + v * row).flatten(1, 2)
    start, way = (points, fixed[:, 0]) if parallel else (fixed[:, 0], points)
    start, way = torch.broadcast_tensors(start, way)

    axis = way.abs().argmax(dim=-1, keepdim=True)
    across = torch.tensor([[1, 2], [0, 2], [0, 1]], device=device)[axis[..., 0]]
    count = torch.tensor(shape, dtype=torch.float64, device=device)[axis]
    middle = (count - 1) / 2
    begin, advance = start.gather(-1, axis), way.gather(-1, axis)
    slope = way.gather(-1, across) / advance
    place = start.gather(-1, across) + (middle - begin) * slope
    steps = [step[:, 0].expand_as(way) for step in (column, row)]
    wide = torch.stack([step.gather(-1, across) - slope * step.gather(-1, axis) for step in steps]).norm(dim=0)
    near = torch.minimum(begin, begin + advance).clamp(-torch.ones_like(count), count)
    far = torch.maximum(begin, begin + advance).clamp(-torch.ones_like(count), count)
    size, growth = (middle - begin) / advance, 1 / advance
    if parallel:
        size, growth = torch.ones_like(size), torch.zeros_like(growth)
    length = (way * sizes).norm(dim=-1, keepdim=True) / advance.abs()

    fields = [axis, near, far, size, growth]
    fields += [part for i in range(2) for part in (place[..., i : i + 1], slope[..., i : i + 1], wide[..., i : i + 1])]
    rays = torch.cat([*fields, length], dim=-1).float().transpose(1, 2).contiguous()

    largest = torch.maximum(size + (near - middle) * growth, size + (far - middle) * growth).clamp(0, 1)
    widest = (largest * wide).clamp(min=1)
    taps = widest.amax(dim=(0, 1)).ceil().int().add(1).tolist()
    ends_inside = torch.logical_or(near > -0.5, far < count - 0.5)
    reach = (ends_inside.double() / 2).expand_as(way).scatter(-1, across, 0.5 + widest / 2) + _SLACK
    reaches = torch.stack([torch.where(axis == i, reach, -1).amax(dim=1) for i in range(3)], dim=1).float()
    inverses = torch.from_numpy(_inverses(views, parallel)).to(device)
    return RayTable(rays, inverses, reaches, (taps[0], taps[1]))


def _inverses(views: Float[np.ndarray, "view 4 3"], parallel: bool) -> Float[np.ndarray, "view 3 4"]:
    """Matrices from voxel index to homogeneous column and row of the panel, see `RayTable`."""
    fixed, corner, column, row = np.moveaxis(views, 1, 0)
    start, way = (corner, fixed) if parallel else (fixed, corner)
    normals = np.stack([np.cross(column, row), np.cross(row, way), np.cross(way, column)], axis=1)
    volume = np.einsum("vi,vi->v", way, normals[:, 0])[:, None, None]
    scale = np.linalg.norm(np.stack([way, column, row]), axis=-1).prod(axis=0)[:, None, None]
    solvable = np.abs(volume) > _FLAT * scale
    matrix = normals / np.where(solvable, volume, 1.0)
    inverse = np.concatenate([matrix, -matrix @ start[:, :, None]], axis=-1)
    if parallel:
        inverse[:, 0] = [0, 0, 0, 1]
    return np.where(solvable, inverse, 0.0).astype(np.float32)
