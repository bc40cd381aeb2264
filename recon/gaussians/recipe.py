"""Every number that steers a fit, in one place."""

from dataclasses import dataclass, fields

from spectra.errors import InputError

_ANY_SIGN = (
    "name", "stages", "seed", "warm_up", "momentum", "dispersion", "prior", "held_out"
)  # fmt: skip


FEW = 75  # views, up to which Gaussians are as far apart as the recipe says; of fewer, each may be used more often
FINEST = 0.9  # voxels; what more views do not make finer


@dataclass(frozen=True)
class Stage:
    """A part of the fit at one binning of the detector.

    Parameters
    ----------
    pixel : largest pixel to use, as seen at the isocentre, in voxels; finer pixels are summed
    sweeps : times every training view is used; see also `Recipe.most_turns`
    """

    pixel: float
    sweeps: float


@dataclass(frozen=True)
class Recipe:
    """Hyper-parameters of a fit; lengths in voxels of the reconstruction grid unless said otherwise.

    Parameters
    ----------
    name : what ``--recipe`` calls it
    stages : binnings and how long each lasts
    views_per_step : views whose gradients make one step
    most_turns : how many times as many sweeps at most, where fewer than 75 views would make fewer steps than those
    spacing : distance between Gaussians along edges; shorter with more than 75 views, see `Recipe.distance`
    voxel_passes : over the views at full resolution, for the voxels that a fit with a prior starts from
    approximation : evaluations that bring the Gaussians close to voxels
    dispersion : relative model error added to the Poisson variance, so that what is left of partial volume at edges
        does not rule
    node_tolerance : largest error of the log counts that compressing the energy grid may cause
    centre_rate : first step of a coordinate
    shape_rate : first step of a log-scale and of a quaternion's component [no unit]
    final_rate : last step over first
    coefficient_rate : step of the coefficients over the step that full curvature would take
    momentum : of the coefficients
    curvature_sweeps : sweeps between two evaluations of the coefficients' curvature
    warm_up : sweeps over which steps of the geometry grow to their length
    prior : information of the prior over that of the data, see `recon.gaussians.voxel_prior`; 0 starts from decomposed
        rays instead, further off, and wants larger rates
    steps_along_edges : weight of the prior along edges, over its weight elsewhere, times the number of steps: voxels
        blur edges, and many steps find them better than few
    seed : of the placement, of the order of views, and of which are held out
    held_out : training views that are not fitted; the fit ends when chi-square on them no longer falls; 0 for none
    """

    name: str = "own"
    stages: tuple[Stage, ...] = (Stage(0.5, 1.0),)
    views_per_step: int = 1
    most_turns: float = 1.0
    spacing: float = 1.0
    voxel_passes: int = 8
    approximation: int = 60
    dispersion: float = 0.02
    node_tolerance: float = 1e-3
    centre_rate: float = 0.02
    shape_rate: float = 0.005
    final_rate: float = 0.05
    coefficient_rate: float = 1.0
    momentum: float = 0.9
    curvature_sweeps: float = 2.0
    warm_up: float = 0.5
    prior: float = 0.3
    steps_along_edges: float = 18.0
    seed: int = 0
    held_out: int = 0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name not in _ANY_SIGN and value <= 0:
                raise InputError(f"recipe {field.name} must be positive, got {value}")
        if self.held_out < 0:
            raise InputError(f"recipe held_out must be a number of views, 0 or more, got {self.held_out}")
        if not self.stages:
            raise InputError("a recipe needs at least one stage")

    def steps(self, views: int) -> list[int]:
        """Steps of each stage with so many training views."""
        more = min(max(FEW / views, 1.0), self.most_turns)
        return [max(round(stage.sweeps * self.per_sweep(views) * more), 1) for stage in self.stages]

    def per_sweep(self, views: int) -> int:
        """Steps of a sweep over so many training views."""
        return max(views // self.views_per_step, 1)

    def curvature_steps(self, views: int) -> int:
        """Steps between two evaluations of the coefficients' curvature."""
        return max(round(self.curvature_sweeps * self.per_sweep(views)), 1)

    def distance(self, views: int) -> float:
        """Distance between Gaussians along edges with so many training views: less noise shows finer things."""
        return min(self.spacing, max(self.spacing * (FEW / views) ** (1 / 6), FINEST))

    def prior_along_edges(self, views: int) -> float:
        """Weight of the prior along edges, over its weight elsewhere, with so many training views."""
        return min(self.steps_along_edges / sum(self.steps(views)), 1.0)


FAST = Recipe(name="fast", most_turns=4.0)
BEST = Recipe(name="best", most_turns=4.0, stages=(Stage(0.5, 4.0),), spacing=0.9)
RECIPES = {recipe.name: recipe for recipe in (FAST, BEST)}
