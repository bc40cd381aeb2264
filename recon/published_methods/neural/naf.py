"""A coordinate network, in the manner of NAF (Zha et al. 2022, arXiv:2209.14540) and IntraTomo (Zang et al. 2021).

Features of a place from grids of several sizes, a small perceptron, line integrals by sums over random points of rays,
Adam. Simplified: one network has all channels, or bases, as its outputs, which share features; grids are dense where
NAF hashes them, as the volumes here fit into its table; rays of a step come from all views; IntraTomo's second module,
which regularises between rounds of training, is left out.
"""

from dataclasses import dataclass

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.neural.networks import FeatureGrids, Field, Perceptron
from recon.published_methods.neural.rays import Rays
from recon.published_methods.neural.training import Schedule, attenuation_units, train
from recon.voxel.method import Images, OnIteration, Volumes, Weights, unwatched
from spectra.threads import without_other_pools

REPORT_EVERY = 20  # steps


@dataclass(frozen=True)
class Neural:
    """A coordinate network as a method.

    Parameters
    ----------
    iterations : steps of Adam
    rays, points : rays per step, and points on each
    levels, coarsest, features : grids of features; the finest has as many nodes along an edge as the volume has voxels
    hidden, layers : size of the perceptron
    rate, network_rate : first learning rates of features and perceptron; they fall to a tenth
    seed : of the first weights and the choice of rays
    """

    iterations: int = 1000
    rays: int = 1024
    points: int = 96
    levels: int = 6
    coarsest: int = 8
    features: int = 2
    hidden: int = 32
    layers: int = 2
    rate: float = 0.1
    network_rate: float = 0.01
    seed: int = 0

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "neural"

    @without_other_pools()
    def reconstruct(
        self,
        line_integrals: Images,
        weights: Weights | None,
        geometry: Geometry,
        grid: Grid,
        on_iteration: OnIteration = unwatched,
    ) -> Volumes:
        """See `recon.voxel.method.LinearMethod`."""
        rays = Rays(line_integrals, weights, geometry, grid, self.seed)
        encoding = FeatureGrids(self.levels, self.coarsest, max(grid.shape), self.features)
        network = Perceptron(encoding.width, self.hidden, self.layers, len(line_integrals))
        field = Field(encoding, network, attenuation_units(line_integrals, grid), self.seed)
        rates = (self.rate, self.network_rate)
        schedule = Schedule(self.iterations, self.rays, self.points, *rates, REPORT_EVERY)
        return train(field, rays, rays.anywhere, grid, schedule, on_iteration)
