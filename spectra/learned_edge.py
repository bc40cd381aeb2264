"""K edges whose energy and width can be learned: basis columns as torch tensors with gradients.

The columns are those of `spectra.basis.basis` for ``sigmoid`` and ``step``; E_n is kept at the value given, so that the
meaning of coefficients does not move with the edge.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from spectra.errors import InputError

if TYPE_CHECKING:
    from spectra.transmission import Transmission


def edge_column(
    energy: Float[Tensor, " node"],
    edge_energy: Float[Tensor, ""],
    edge_width: Float[Tensor, ""],
    normalisation_energy: float | None = None,
) -> Float[Tensor, " node"]:
    """Compute the column of a smooth edge, s((E - E_K) / width), times (E / E_n)^-3 where E_n is given.

    Parameters
    ----------
    energy : nodes [keV]
    edge_energy, edge_width : E_K and 1/gamma [keV], scalars; the width must be positive
    normalisation_energy : E_n [keV] of a ``step``; None for a ``sigmoid``

    Returns
    -------
    values at the nodes, with gradients in `edge_energy` and `edge_width`; no unit

    Raises
    ------
    InputError
        When the width is not positive.

    Notes
    -----
    Gradients know the nodes only. With nodes dE apart they follow the edge as long as gamma dE <~ 2, that is, for
    widths of at least dE / 2: inside one step of 1.875 keV the gradient in E_K varies by a factor of 1.3 at gamma 2,
    2.5 at gamma 3, 15 at gamma 5 and 1600 at gamma 10 per keV, and the loss becomes a staircase whose treads have no
    slope. `steepest_width` gives that limit for a grid. Learn with a wide edge, and narrow it or refine the nodes
    later.
    """
    width = edge_width.detach().item()
    if not width > 0:
        raise InputError(f"the width of an edge that is learned must be positive, got {width:g} keV")
    step = torch.sigmoid((energy - edge_energy) / edge_width)
    return step if normalisation_energy is None else step * (energy / normalisation_energy) ** -3


def steepest_width(energy: Float[Tensor, " node"], edge_energy: float) -> float:
    """Return the smallest edge width [keV] for which gradients in the edge's energy are reliable: gamma dE = 2.

    dE is the distance of the nodes on both sides of the edge; infinite outside the nodes.

    Parameters
    ----------
    energy : nodes [keV]
    edge_energy : energy of the edge [keV]

    Returns
    -------
    half the distance of the two nodes beside the edge [keV]
    """
    nodes = torch.sort(energy.detach().double()).values
    above = int(torch.searchsorted(nodes, torch.tensor(float(edge_energy), dtype=nodes.dtype)))
    if not 0 < above < len(nodes):
        return float("inf")
    return float(nodes[above] - nodes[above - 1]) / 2


def transmit_with_edges(
    lengths: Float[Tensor, "... basis"], transmission: "Transmission", columns: Sequence[tuple[int, Tensor]]
) -> Float[Tensor, "... channel"]:
    """Compute expected counts with some columns of a transmission replaced by tensors that carry gradients.

    Parameters
    ----------
    lengths : line integrals
    transmission : everything else; its nodes must be energies, so not a compressed one
    columns : index of a column, and its values at the nodes (see `edge_column`); nodes are listed channel by channel

    Returns
    -------
    expected counts, (..., C)

    Raises
    ------
    InputError
        When the columns do not fit the transmission.

    Notes
    -----
    In plain torch, differentiable any number of times in lengths, edge energies and widths; a few times slower than
    `spectra.ops.transmit`, which is for fixed columns.
    """
    count = len(transmission.weights)
    rows = list(torch.as_tensor(transmission.columns).to(lengths))
    for index, values in columns:
        if not 0 <= index < len(rows) or values.shape != (count,):
            raise InputError(
                f"column {index} of shape {tuple(values.shape)} does not fit {len(rows)} columns of {count} nodes"
            )
        rows[index] = values
    parts = torch.as_tensor(transmission.weights).to(lengths) * torch.exp(-lengths @ torch.stack(rows))
    sizes = (transmission.starts[1:] - transmission.starts[:-1]).tolist()
    return torch.stack([part.sum(dim=-1) for part in torch.split(parts, sizes, dim=-1)], dim=-1)
