"""A line-segment transformer, in the manner of SAX-NeRF (Cai et al. 2024, arXiv:2311.10959).

The points of a ray are cut into segments, and those of one attend to each other before they become attenuation; half of
the rays of a step come from windows of 8 x 8 pixels in front of the object, half from anywhere. Simplified: two blocks
of 32 numbers that train on a CPU; one network for all channels; dense grids of features in the place of a hash table,
as in `recon.published_methods.neural.naf`. A volume is read off along rows of voxels, as the original does: what a
voxel gets depends on its neighbours in x.
"""

from dataclasses import dataclass

from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.published_methods.neural.networks import SEGMENT, FeatureGrids, Field, Lineformer
from recon.published_methods.neural.rays import Rays
from recon.published_methods.neural.training import Schedule, attenuation_units, train
from recon.voxel.method import Images, OnIteration, Volumes, Weights, unwatched
from spectra.errors import InputError
from spectra.threads import without_other_pools

REPORT_EVERY = 10  # steps


@dataclass(frozen=True)
class SaxNerf:
    """A line-segment transformer as a method.

    Parameters
    ----------
    iterations : steps of Adam
    rays, points : rays per step, about, and points on each, a multiple of 8
    levels, coarsest, features : grids of features; the finest has as many nodes along an edge as the volume has voxels
    hidden, blocks, heads : size of the transformer
    rate, network_rate : first learning rates of features and transformer; they fall to a tenth
    seed : of the first weights and the choice of rays
    """

    iterations: int = 300
    rays: int = 1024
    points: int = 64
    levels: int = 6
    coarsest: int = 8
    features: int = 2
    hidden: int = 32
    blocks: int = 2
    heads: int = 2
    rate: float = 0.1
    network_rate: float = 0.005
    seed: int = 0

    def __post_init__(self) -> None:
        if self.points % SEGMENT:
            raise InputError(f"sax-nerf points on a ray must be a multiple of {SEGMENT}, got {self.points}")
        if self.hidden % self.heads:
            raise InputError(f"sax-nerf hidden must be a multiple of heads, got {self.hidden} and {self.heads}")

    @property
    def name(self) -> str:
        """What ``--method`` calls it."""
        return "sax-nerf"

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
        network = Lineformer(encoding.width, self.hidden, self.blocks, self.heads, len(line_integrals))
        field = Field(encoding, network, attenuation_units(line_integrals, grid), self.seed)
        rates = (self.rate, self.network_rate)
        schedule = Schedule(self.iterations, self.rays, self.points, *rates, REPORT_EVERY)
        return train(field, rays, rays.masked, grid, schedule, on_iteration)
