"""A coordinate network, after NAF and IntraTomo.

Features of a position from grids of several sizes, a small perceptron, line integrals as sums over random points of
rays, Adam. Simplified: one network has all channels, or bases, as its outputs, which share features; grids are dense
where NAF hashes them, as the volumes here fit into its table; rays of a step come from all views; IntraTomo's second
module, which regularises the volume between rounds of training, is left out.

References
----------
Zha, Zhang, Li 2022, NAF: neural attenuation fields for sparse-view CBCT reconstruction, MICCAI, arXiv:2209.14540.
Zang, Idoughi, Li, Wonka, Heidrich 2021, IntraTomo: self-supervised learning-based tomography via sinogram synthesis and
prediction, ICCV.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import nn

from recon.published_methods.neural.networks import Perceptron
from recon.published_methods.neural.rays import RayNumbers, Rays
from recon.published_methods.neural.training import CoordinateNetwork


@dataclass(frozen=True)
class Neural(CoordinateNetwork):
    """A grid of features and a perceptron.

    Parameters
    ----------
    layers : hidden layers of the perceptron
    """

    layers: int = 2

    report_every: ClassVar[int] = 20  # steps between two reports

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "neural"

    def network(self, inputs: int, outputs: int) -> nn.Module:
        """Create the perceptron.

        Parameters
        ----------
        inputs : number of features of a position
        outputs : number of channels or bases

        Returns
        -------
        perceptron
        """
        return Perceptron(inputs, self.hidden, self.layers, outputs)

    def sampler(self, rays: Rays) -> Callable[[int], RayNumbers]:
        """Choose rays anywhere.

        Parameters
        ----------
        rays : rays of the scan

        Returns
        -------
        function that chooses a number of rays
        """
        return rays.anywhere
