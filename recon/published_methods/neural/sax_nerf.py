"""A line-segment transformer, after SAX-NeRF.

The points of a ray are divided into segments, and the points of one segment attend to each other before attenuation is
computed; half of the rays of a step come from windows of 8 x 8 pixels in front of the object, half from anywhere.
Simplified: two blocks of width 32 that train on a CPU; one network for all channels; dense grids of features in place
of a hash table, as in `recon.published_methods.neural.naf`. As in the original, a volume is computed along rows of
voxels, so that the value of a voxel depends on its neighbours in x.

References
----------
Cai, Wang, Yuille, Zhou, Wang 2024, Structure-aware sparse-view X-ray 3D reconstruction, CVPR, arXiv:2311.10959.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from torch import nn

from recon.published_methods.neural.networks import SEGMENT, Lineformer
from recon.published_methods.neural.rays import RayNumbers, Rays
from recon.published_methods.neural.training import CoordinateNetwork
from spectra.errors import InputError


@dataclass(frozen=True)
class SaxNerf(CoordinateNetwork):
    """A grid of features and a line-segment transformer; `points` is a multiple of 8.

    Parameters
    ----------
    iterations, points, network_rate : as in `CoordinateNetwork`, with other values
    blocks, heads : number of blocks of the transformer, and heads of each
    """

    iterations: int = 300
    points: int = 64
    network_rate: float = 0.005
    blocks: int = 2
    heads: int = 2

    report_every: ClassVar[int] = 10  # steps between two reports

    def __post_init__(self) -> None:
        if self.points % SEGMENT:
            raise InputError(f"sax-nerf points on a ray must be a multiple of {SEGMENT}, got {self.points}")
        if self.hidden % self.heads:
            raise InputError(f"sax-nerf hidden must be a multiple of heads, got {self.hidden} and {self.heads}")

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "sax-nerf"

    def network(self, inputs: int, outputs: int) -> nn.Module:
        """Create the transformer.

        Parameters
        ----------
        inputs : number of features of a position
        outputs : number of channels or bases

        Returns
        -------
        line-segment transformer
        """
        return Lineformer(inputs, self.hidden, self.blocks, self.heads, outputs)

    def sampler(self, rays: Rays) -> Callable[[int], RayNumbers]:
        """Choose half of the rays in front of the object.

        Parameters
        ----------
        rays : rays of the scan

        Returns
        -------
        function that chooses about a number of rays
        """
        return rays.masked
