"""Settings of the stages of a fit that need no change from scan to scan; `recon.gaussians.recipe.Recipe` holds them.

Every field says its unit, its meaning, and where its value was chosen: 'measured' values have their numbers in
docs/explanation/the_fit.md, and of others no measurement is kept. `python -m benchmarks.reconstruction.ablation`
measures a change.
"""

from collections.abc import Collection
from dataclasses import dataclass, fields
from math import gcd
from typing import Any

from spectra.errors import InputError


def check_positive(settings: Any, name: str, others: Collection[str] = ()) -> None:
    """Refuse settings of which a number is not positive.

    Parameters
    ----------
    settings : a dataclass; fields that are no numbers are passed over
    name : what a message calls the settings
    others : fields that may be 0 or negative

    Raises
    ------
    InputError
        When a number is 0 or less.
    """
    for field in fields(settings):
        value = getattr(settings, field.name)
        if isinstance(value, int | float) and field.name not in others and not value > 0:
            raise InputError(f"{name} {field.name} must be positive, got {value}")


@dataclass(frozen=True)
class PlacementSettings:
    """How the first Gaussians are placed and shaped (`recon.gaussians.initial.initialize`).

    Parameters
    ----------
    coarsest : largest distance between Gaussians over the smallest [no unit]; chosen by hand, not measured
    growth : increase of that distance per distance from an edge [no unit]; chosen by hand, not measured
    overlap : standard deviation of a Gaussian over the distance to its neighbours [no unit]; chosen by hand, not
        measured
    neighbours : Gaussians whose distance is meant, the nearest ones; chosen by hand, not measured
    flatness : thickness over width of a Gaussian on a full edge [no unit]; measured against 0.5
    least_sum : smallest sum of all Gaussians at a centre that a coefficient is divided by [no unit]; chosen by hand,
        not measured
    count : number of Gaussians, about, for which all distances get one factor; 0, the value of both recipes, for as
        many as the distances give
    """

    coarsest: float = 3.5
    growth: float = 0.3
    overlap: float = 0.65
    neighbours: int = 6
    flatness: float = 0.25
    least_sum: float = 0.5
    count: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "recipe placement", ("count",))


@dataclass(frozen=True)
class SurfaceSettings:
    """How Gaussians that planes divide are placed and sharpened (`recon.gaussians.divided`); lengths in voxels.

    Parameters
    ----------
    spacing : distance between Gaussians on a surface over the radius in which a plane describes it [no unit]; measured
        against 0.9
    finest : smallest of these distances [voxels]; measured against 1.5
    coarsest : largest of these distances [voxels]; chosen by hand, not measured
    growth : increase of the distance per distance from a surface [no unit]; chosen by hand, not measured
    overlap : standard deviation of a Gaussian over the distance to its neighbours [no unit]; chosen by hand, not
        measured
    neighbours : Gaussians whose distance is meant, the nearest ones; chosen by hand, not measured
    contrast : smallest gradient on a surface, over a large signal (`recon.data.volume_edges.large_signal`) [1/voxel];
        chosen by hand, not measured
    empty : smallest value of a voxel with Gaussians, over a large signal [no unit]; chosen by hand, not measured
    air : empty voxels around the object, so that faces at the border of its box are surfaces, and that Gaussians which
        extend beyond it are fitted to nothing there; chosen by hand, not measured
    radii : radii in which planes are tried [voxels]; chosen by hand, not measured
    tolerance : largest root mean square distance of a surface from its plane [voxels]; chosen by hand, not measured
    foreign : largest part of the points around that belong to another surface [no unit]; chosen by hand, not measured
    least_sum : smallest sum of all Gaussians at a centre that a coefficient is divided by [no unit]; chosen by hand,
        not measured
    first_width : width of the transition while Gaussians are fitted to the voxel volumes [voxels]; measured against 0.1
        and 0.3
    width : width of the transition while they are fitted to the counts [voxels]; measured against 0.12, 0.15 and 0.2
    cutoff : distance at which a Gaussian ends while they are fitted to the voxel volumes [standard deviations]; 0.9 %
        of its mass lies beyond, which the volumes are scaled by; measured against 3 and 4
    solves : iterations of conjugate gradients for the first coefficients, on voxels of twice the size; chosen by hand,
        not measured
    count : number of Gaussians, about, for which all distances get one factor; 0, the value of both recipes, for as
        many as the distances give
    """

    spacing: float = 0.6
    finest: float = 1.2
    coarsest: float = 9.0
    growth: float = 0.5
    overlap: float = 0.65
    neighbours: int = 6
    contrast: float = 0.02
    empty: float = 0.02
    air: int = 6
    radii: tuple[float, ...] = (9.0, 7.0, 5.0, 3.5, 2.5)
    tolerance: float = 0.15
    foreign: float = 0.03
    least_sum: float = 0.5
    first_width: float = 0.15
    width: float = 0.1
    cutoff: float = 3.4
    solves: int = 12
    count: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "recipe surfaces", ("count",))


@dataclass(frozen=True)
class VolumeFitSettings:
    """How Gaussians are fitted to the voxel volumes, without rays (`recon.gaussians.initial.fit_to_volume`).

    Parameters
    ----------
    cutoff : distance at which a Gaussian ends [standard deviations]; 2 % of its mass lies beyond, and a third of the
        time would be spent there; measured: a test holds the squared distance to 1.1 times that without a cutoff
    halfway : weight of the squared distance on the grid half a voxel further along every axis, over that on the voxels
        [no unit]; 0 leaves it out, which takes half the time; 0.1, with a cutoff of 3.5, was measured by
        `python -m benchmarks.reconstruction.scene_kinds --halfway 0.1`
    renewal : evaluations between two computations of the diagonal, each of which costs as much as an evaluation;
        chosen by hand, not measured
    longest_move : longest step of a centre along an axis [standard deviations there]; chosen by hand, not measured
    longest_scaling : longest step of a log-scale [no unit]; chosen by hand, not measured
    longest_turn : longest rotation about an axis [rad]; chosen by hand, not measured
    step_length : length of the first steps over those that the diagonal suggests [no unit]; chosen by hand, not
        measured
    rise : factor of the last distance; a step that leads further away is not taken [no unit]; chosen by hand, not
        measured
    shortening : length of all later steps after such a step, over that before [no unit]; chosen by hand, not measured
    momentum : largest part of the last step that goes into the next [no unit]; chosen by hand, not measured
    widest : longest standard deviation of a Gaussian over that at the start [no unit]; measured on `bird-chest`
        against no bound
    many : number of Gaussians; fewer take less time per evaluation and get more evaluations; measured with `most`
        together, on a small scan by several processors
    most : largest factor of the evaluations for few Gaussians [no unit]; measured with `many`
    peak : quantile of the positive values of a basis that its differences are measured in [no unit]; chosen by hand,
        not measured
    faintest : part of the signal of the basis with the largest signal; a basis with less counts as if it had as much
        [no unit]; chosen by hand, not measured
    least_energy : part of the mean squared coefficient of all Gaussians that is added to that of each in the diagonal
        [no unit]; chosen by hand, not measured
    least_turning : curvature along a rotation of a round Gaussian over that of an elongated one [no unit]; chosen by
        hand, not measured
    """

    cutoff: float = 3.1
    halfway: float = 0.0
    renewal: int = 5
    longest_move: float = 0.5
    longest_scaling: float = 0.3
    longest_turn: float = 0.2
    step_length: float = 0.4
    rise: float = 1.0005
    shortening: float = 0.7
    momentum: float = 0.9
    widest: float = 2.0
    many: int = 20_000
    most: float = 2.5
    peak: float = 0.999
    faintest: float = 0.01
    least_energy: float = 0.01
    least_turning: float = 0.01

    def __post_init__(self) -> None:
        check_positive(self, "recipe volume_fit", ("halfway",))
        if self.halfway < 0:
            raise InputError(f"recipe volume_fit halfway must not be negative, got {self.halfway}")


@dataclass(frozen=True)
class PriorSettings:
    """How the voxel prior is evaluated (`recon.gaussians.voxel_prior`).

    Parameters
    ----------
    cutoff : distance at which a Gaussian ends [standard deviations]; chosen by hand, not measured
    slabs : parts of the volume, one of which gives the gradient of each step; measured against one slab
    slab_stride : slabs from one step to the next, so that neighbouring steps use slabs that do not touch; chosen by
        hand, not measured
    edge_width : voxels across which an edge lowers the trust in the volumes; chosen by hand, not measured
    metal_power : power of the density, over that of the least dense metal, by which the trust along edges falls [no
        unit]; measured on scenes with an implant and with pins against 2 and 8
    """

    cutoff: float = 3.5
    slabs: int = 8
    slab_stride: int = 3
    edge_width: int = 3
    metal_power: int = 4

    def __post_init__(self) -> None:
        check_positive(self, "recipe voxel_prior")
        if gcd(self.slabs, self.slab_stride) > 1:
            raise InputError(
                "recipe voxel_prior slabs and slab_stride must have no common factor, so that every slab is used, got "
                f"{self.slabs} and {self.slab_stride}"
            )


@dataclass(frozen=True)
class OptimizerSettings:
    """How steps are made and when they end (`recon.gaussians.optimize`, `recon.gaussians.objective`).

    Parameters
    ----------
    gradient_decay : of Adam's mean of gradients, per step [no unit]; the value of Kingma & Ba 2015
    square_decay : of Adam's mean of squared gradients, per step [no unit]; chosen by hand, not measured; Kingma & Ba
        have 0.999, a memory longer than a fit of 75 steps
    curvature_views : views that see a Gaussian, on average, and that the curvature of the coefficients is computed
        from; chosen by hand, not measured
    relative_damping : part of its own curvature that is added to that of each coefficient [no unit]; chosen by hand,
        not measured
    mean_damping : part of the mean curvature that is added, so that a Gaussian which no ray meets stays as it is [no
        unit]; chosen by hand, not measured
    holding : times its own curvature is added to that of a coefficient that is held [no unit]; large against 1
    coefficient_full : part of the steps in which steps of the coefficients have full length [no unit]; chosen by hand,
        not measured
    coefficient_final : length of the last step of the coefficients over the full length [no unit]; chosen by hand, not
        measured
    rise : deviance of a sweep over that of the one before, above which steps of the coefficients become shorter [no
        unit]; chosen by hand, not measured
    shortening : factor of the length of these steps after such a sweep [no unit]; chosen by hand; without it twenty
        sweeps over 13 views led from a deviance of 21 to 12,000
    divergence : mean deviance of the recent steps over its smallest value so far, above which the fit begins anew with
        more views per step [no unit]; chosen by hand, not measured
    recent : number of steps over which that mean reaches; chosen by hand, not measured
    more_views : factor of the views per step of a fit that begins anew; measured on six bases, where 4 is enough
    slower : factor of the steps of the coefficients of such a fit [no unit]; measured on two scans against 1 and 0.5
    patience : looks at held-out views in a row without progress that end a fit; chosen by hand, not measured
    """

    gradient_decay: float = 0.9
    square_decay: float = 0.99
    curvature_views: int = 12
    relative_damping: float = 1e-4
    mean_damping: float = 1e-6
    holding: float = 1e6
    coefficient_full: float = 0.5
    coefficient_final: float = 0.1
    rise: float = 1.1
    shortening: float = 0.5
    divergence: float = 10.0
    recent: float = 10.0
    more_views: int = 4
    slower: float = 0.3
    patience: int = 2

    def __post_init__(self) -> None:
        check_positive(self, "recipe optimizer")


@dataclass(frozen=True)
class ResidualSettings:
    """What voxels take of that which Gaussians leave unexplained (`recon.gaussians.residual`).

    Parameters
    ----------
    strength : weight of the total variation of the residual over that of the voxels of the start [no unit]; measured on
        five scenes
    least : part of the largest value of a basis, which a voxel must exceed to have a residual [no unit]; measured on
        five scenes
    worth : fall of the deviance of all rays per number that the residual takes, below which it is left out [no unit];
        measured on seven scenes
    passes : passes of the one-step voxel method over the views; 0 for no residual; measured on five scenes
    """

    strength: float = 0.5
    least: float = 5e-3
    worth: float = 0.25
    passes: int = 0

    def __post_init__(self) -> None:
        check_positive(self, "recipe residual", others=("passes",))
        if self.passes < 0:
            raise InputError(f"recipe residual passes must be a number of passes, 0 or more, got {self.passes}")


@dataclass(frozen=True)
class UnseenRaysSettings:
    """Which rays no part of a fit uses, and when they decide (`recon.gaussians.unseen_rays`).

    Parameters
    ----------
    views : views with such rays, at most, evenly spread; the standard error of the decision is over these; chosen by
        hand, not measured
    part : part of all rays [no unit]; measured on `kedge-small` against none
    block : edge of a block of such pixels, as seen at the isocentre [voxels]; that of the coarsest voxels of the
        start, so that no binning sums these pixels with others
    certain : difference of two models that counts [standard errors over views]; measured on five scans
    """

    views: int = 8
    part: float = 1 / 64
    block: float = 4.0
    certain: float = 1.5

    def __post_init__(self) -> None:
        check_positive(self, "recipe unseen_rays")
