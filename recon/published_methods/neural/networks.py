"""Attenuation from positions: grids of features that are learned, a perceptron, and a transformer along segments."""

import math
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

SEGMENT = 8  # points of a ray that attend to each other; our choice
QUIET = 2.0  # no unit; subtracted from raw outputs: an untrained network gives softplus(-2) = 0.13; our choice
SMALL = 1e-2  # no unit; largest first feature; our choice

Places = Float[Tensor, "line point 3"]
Attenuation = Float[Tensor, "line point channel"]


class FeatureGrids(nn.Module):
    """Features at the nodes of cubic grids from coarse to fine, interpolated linearly.

    Parameters
    ----------
    levels : number of grids, each finer than the one before by the same factor
    coarsest, finest : nodes along an edge of the first and the last grid
    features : numbers per node

    References
    ----------
    Mueller, Evans, Schied, Keller 2022, doi:10.1145/3528223.3530127: a hash grid whose table has room for all nodes.
    """

    def __init__(self, levels: int, coarsest: int, finest: int, features: int) -> None:
        super().__init__()
        factor = (max(finest, coarsest) / coarsest) ** (1 / max(levels - 1, 1))
        sizes = [round(coarsest * factor**level) for level in range(levels)]
        self.grids = nn.ParameterList([torch.empty(1, features, n, n, n) for n in sizes])
        self.width = levels * features

    def forward(self, places: Places) -> Float[Tensor, "line point feature"]:
        """Interpolate the features of all grids.

        Parameters
        ----------
        places : positions in the box of the grid, -1 to 1 (x, y, z)

        Returns
        -------
        features of the grids from coarse to fine, one after the other
        """
        flat = places.reshape(1, -1, 1, 1, 3)
        options = {"mode": "bilinear", "padding_mode": "border", "align_corners": True}
        found = [nn.functional.grid_sample(grid, flat, **options)[0, :, :, 0, 0] for grid in self.grids]
        return torch.cat(found).T.reshape(*places.shape[:-1], self.width)


class Perceptron(nn.Module):
    """Perceptron that computes each point by itself.

    Parameters
    ----------
    inputs : number of features
    hidden : width of the hidden layers
    layers : number of hidden layers
    outputs : number of outputs
    """

    def __init__(self, inputs: int, hidden: int, layers: int, outputs: int) -> None:
        super().__init__()
        widths = [inputs, *[hidden] * layers]
        steps = [step for pair in pairwise(widths) for step in (nn.Linear(*pair), nn.LeakyReLU())]
        self.steps = nn.Sequential(*steps, nn.Linear(widths[-1], outputs))

    def forward(self, features: Float[Tensor, "line point feature"]) -> Attenuation:
        """Compute raw outputs.

        Parameters
        ----------
        features : features of the points

        Returns
        -------
        raw outputs of the points
        """
        return self.steps(features)


class Lineformer(nn.Module):
    """Transformer in which points of a line attend to those of their segment of `SEGMENT` points.

    A block is attention, then a perceptron, each after a normalisation and added to its input.

    Parameters
    ----------
    inputs : number of features
    hidden : width of the blocks
    blocks : number of blocks
    heads : heads of the attention of a block
    outputs : number of outputs

    References
    ----------
    Cai, Wang, Yuille, Zhou, Wang 2024, arXiv:2311.10959.
    """

    def __init__(self, inputs: int, hidden: int, blocks: int, heads: int, outputs: int) -> None:
        super().__init__()
        self.heads = heads
        self.enter, self.leave = nn.Linear(inputs, hidden), nn.Linear(hidden, outputs)
        self.attend = nn.ModuleList([nn.Linear(hidden, 3 * hidden) for _ in range(blocks)])
        self.mix = nn.ModuleList([nn.Linear(hidden, hidden) for _ in range(blocks)])
        self.perceptrons = nn.ModuleList([Perceptron(hidden, 2 * hidden, 1, hidden) for _ in range(blocks)])
        self.norms = nn.ModuleList([nn.LayerNorm(hidden) for _ in range(2 * blocks)])

    def forward(self, features: Float[Tensor, "line point feature"]) -> Attenuation:
        """Compute raw outputs.

        Parameters
        ----------
        features : features of the points; the number of points on a line is a multiple of `SEGMENT`

        Returns
        -------
        raw outputs of the points
        """
        lines, points, _ = features.shape
        x = self.enter(features).reshape(lines * points // SEGMENT, SEGMENT, -1)
        for number, (attend, mix, perceptron) in enumerate(zip(self.attend, self.mix, self.perceptrons, strict=True)):
            parts = attend(self.norms[2 * number](x)).reshape(len(x), SEGMENT, 3, self.heads, -1)
            query, key, value = parts.permute(2, 0, 3, 1, 4)
            weights = torch.softmax(query @ key.mT / math.sqrt(query.shape[-1]), dim=-1)
            x = x + mix((weights @ value).transpose(1, 2).reshape(len(x), SEGMENT, -1))
            x = x + perceptron(self.norms[2 * number + 1](x))
        return self.leave(x).reshape(lines, points, -1)


class Field(nn.Module):
    """Attenuation of every channel at any position in the box, never negative.

    Parameters
    ----------
    encoding : features of a position
    network : network from features to raw outputs
    units : attenuation that is 1 for the network, per channel [1/mm]
    seed : seed of the first weights
    """

    def __init__(self, encoding: FeatureGrids, network: nn.Module, units: Float[Tensor, " channel"], seed: int) -> None:
        super().__init__()
        self.encoding, self.network, self.units = encoding, network, units
        generator = torch.Generator().manual_seed(seed)
        with torch.no_grad():
            for module in network.modules():
                if isinstance(module, nn.Linear):
                    bound = 1 / math.sqrt(module.in_features)
                    module.weight.uniform_(-bound, bound, generator=generator)
                    module.bias.zero_()
            for grid in encoding.grids:
                grid.uniform_(-SMALL, SMALL, generator=generator)

    def forward(self, places: Places) -> Attenuation:
        """Compute attenuation.

        Parameters
        ----------
        places : positions in the box of the grid, -1 to 1 (x, y, z)

        Returns
        -------
        attenuation [1/mm]
        """
        return self.units * nn.functional.softplus(self.network(self.encoding(places)) - QUIET)
