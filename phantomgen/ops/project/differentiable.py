"""The voxel projector in plain torch: differentiable in volume and poses, any precision and device, and slow.

Same model as `phantomgen.ops.project.cpu`. A beam's part of a layer is a difference of running sums, which are linear
between the edges of voxels; automatic differentiation is then exact in everything. Memory grows as rays x layers.
"""

import torch
from jaxtyping import Float, Int
from torch import Tensor


def forward(
    volume: Float[Tensor, "component z y x"],
    views: Float[Tensor, "view 4 3"],
    parallel: bool,
    spacing: Float[Tensor, " 3"],
    rows: int,
    columns: int,
) -> Float[Tensor, "component view row column"]:
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
    line integrals, in the precision of the arguments
    """
    v, u = torch.meshgrid(torch.arange(rows).to(views), torch.arange(columns).to(views), indexing="ij")
    pixels = torch.stack([u.flatten(), v.flatten()], dim=1)
    images = [_view(volume, frame, parallel, spacing, pixels) for frame in views]
    empty = volume.new_zeros(len(volume), 0, rows, columns)
    return torch.stack(images, dim=1).unflatten(2, (rows, columns)) if images else empty


def _view(
    volume: Float[Tensor, "component z y x"],
    frame: Float[Tensor, "4 3"],
    parallel: bool,
    spacing: Float[Tensor, " 3"],
    pixels: Float[Tensor, "ray 2"],
) -> Float[Tensor, "component ray"]:
    """Line integrals through some pixels (column, row) of one view."""
    points = frame[1] + pixels @ frame[2:]
    fixed = frame[0].expand_as(points)
    start, way = (points, fixed) if parallel else (fixed, points)
    axis = way.detach().abs().argmax(dim=1)
    out = volume.new_zeros(len(volume), len(pixels))
    for main in range(3):
        (chosen,) = torch.nonzero(axis == main, as_tuple=True)
        if len(chosen):
            sums = _sums_over_layers(volume, start[chosen], way[chosen], (frame[2:], parallel), main)
            out = out.index_copy(1, chosen, sums)
    return out * (way * spacing).norm(dim=1)


def _sums_over_layers(
    volume: Float[Tensor, "component z y x"],
    start: Float[Tensor, "ray 3"],
    way: Float[Tensor, "ray 3"],
    pixel: tuple[Float[Tensor, "2 3"], bool],
    main: int,
) -> Float[Tensor, "component ray"]:
    """Line integrals of rays with one main axis, over their length; a pixel is its steps, and whether all are alike."""
    steps, parallel = pixel
    edges = torch.arange(volume.shape[1 + main] + 1).to(way) - 0.5
    crossed = ((edges - start[:, main, None]) / way[:, main, None]).clamp(0, 1)
    t, depth = (crossed[:, 1:] + crossed[:, :-1]) / 2, (crossed[:, 1:] - crossed[:, :-1]).abs()
    size = torch.ones_like(t) if parallel else t
    area, ends = 1.0, []
    for across in (i for i in range(3) if i != main):
        shadow = (steps[:, across] - steps[:, main] * (way[:, across] / way[:, main])[:, None]).norm(dim=1)
        width = (size * shadow[:, None]).clamp(min=1)
        middle = start[:, across, None] + t * way[:, across, None]
        ends.append([_edge(middle + side * width, volume.shape[1 + across]) for side in (-0.5, 0.5)])
        area = area * width
    sums = volume.movedim(1 + main, 1).cumsum(2).cumsum(3)
    sums = torch.nn.functional.pad(sums, (1, 0, 1, 0))
    within = sum((2 * i - 1) * (2 * j - 1) * _at(sums, ends[0][i], ends[1][j]) for i in (0, 1) for j in (0, 1))
    return (within * (depth / area)).sum(dim=-1)


def _edge(place: Float[Tensor, "ray layer"], count: int) -> tuple[Int[Tensor, "ray layer"], Float[Tensor, "ray layer"]]:
    """Voxel edge at or before a place, and how far behind it the place lies."""
    x = (place + 0.5).clamp(0, count)
    i = x.detach().floor().clamp(max=count - 1)
    return i.long(), x - i


def _at(
    sums: Float[Tensor, "component layer a_plus_1 b_plus_1"], place_a: tuple[Tensor, Tensor], place_b: tuple
) -> Float[Tensor, "component ray layer"]:
    """Interpolate running sums linearly between edges."""
    (i, past_i), (j, past_j) = place_a, place_b
    layer = torch.arange(sums.shape[1], device=sums.device)
    flat, (height, width) = sums.flatten(1), sums.shape[2:]

    def corner(di: int, dj: int) -> Tensor:
        return flat[:, (layer * height + i + di) * width + j + dj]

    near = corner(0, 0) * (1 - past_j) + corner(0, 1) * past_j
    far = corner(1, 0) * (1 - past_j) + corner(1, 1) * past_j
    return near * (1 - past_i) + far * past_i
