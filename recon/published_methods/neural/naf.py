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

from dataclasses import dataclass

from recon.published_methods.neural.training import CoordinateNetwork, PerceptronField


@dataclass(frozen=True)
class Neural(PerceptronField, CoordinateNetwork):
    """A grid of features and a perceptron."""

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "neural"
