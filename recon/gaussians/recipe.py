"""Every number that steers a fit of Gaussians, in one place.

`docs/explanation/the_fit.md` has all of them as a table, beside the equation that they belong to. Steps that other
folders make have their own: voxels in `recon.voxel.iterative.one_step`, edges in `recon.data.volume_edges`, partial
volume in `recon.data.partial_volume`.
"""

from dataclasses import dataclass, field, replace

from recon.gaussians.settings import (
    OptimizerSettings,
    PlacementSettings,
    PriorSettings,
    ResidualSettings,
    SurfaceSettings,
    UnseenRaysSettings,
    VolumeFitSettings,
    check_positive,
)
from spectra.errors import InputError
from spectra.materials.material_curve import MaterialCurve

KERNELS = ("interface", "gaussian")
RESIDUAL_PASSES = 4  # over the views, of `recon fit --residual`; later ones gain little
_ANY_SIGN = ("seed", "warm_up", "momentum", "dispersion", "prior", "held_out")


@dataclass(frozen=True)
class Stage:
    """A part of the fit at one binning of the detector.

    Parameters
    ----------
    pixel : largest pixel to use, as seen at the isocentre [voxels]; finer pixels are summed
    sweeps : number of times that every training view is used; see also `Recipe.most_turns`
    """

    pixel: float
    sweeps: float


@dataclass(frozen=True)
class Recipe:
    """Settings of a fit; lengths are in voxels of the reconstruction grid.

    'Measured' values have their numbers in docs/explanation/the_fit.md. 'Chosen by hand' means that no measurement of
    other values is kept.

    Parameters
    ----------
    name : value of ``--recipe`` that selects it
    kernel : ``gaussian``, or ``interface`` for Gaussians that planes divide; both were measured on scenes of twelve
        kinds by `python -m benchmarks.reconstruction.scene_kinds`
    stages : binnings and how long each lasts; pixels of half a voxel were measured against whole ones, and one sweep
        (`fast`) and four (`best`) against three
    views_per_step : views whose gradients make one step; measured against 2
    most_turns : largest factor of the sweeps where there are fewer than `few_views` views [no unit]; measured on 10 and
        25 views
    few_views : number of views below which each is used more often, and above which Gaussians are placed closer to each
        other and steps of the geometry are shorter; chosen by hand, not measured
    spacing : distance between Gaussians along edges [voxels], with `few_views` views or fewer; measured against 1.2
    finest_spacing : that distance with any number of views, at least [voxels]; chosen by hand, not measured
    voxel_passes : passes over the views at full resolution, for the voxels that a fit with a prior starts from;
        measured with 4 and 5 on `kedge`
    voxel_fall : part of the deviance by which the last of these passes may lower it; as long as one lowers it by more,
        others follow, up to three times as many [no unit]; measured with a head of thick bone
    approximation : evaluations of the fit to the voxel volumes; measured against 30, and 40 against 20
    dispersion : relative model error eta, which adds (eta Y)^2 to the Poisson variance of an expected count Y [no
        unit]; measured against 0, 0.005 and 0.01
    node_tolerance : largest error of the log counts that a compressed energy grid may cause [no unit]; five times finer
        nodes made no difference
    centre_rate : length of Adam's first steps of a centre [voxels]; half of it was measured
    shape_rate : length of Adam's first steps of a log-scale and of a quaternion's component [no unit]; half of it was
        measured
    final_rate : last of these lengths over the first [no unit]; 0.3 was measured
    coefficient_rate : step of the coefficients over that of Newton's method with the separable curvature [no unit]; 1
        is that step
    momentum : part of the last step of the coefficients that goes into the next [no unit]; measured against 0
    curvature_sweeps : sweeps between two computations of the coefficients' curvature; chosen by hand, not measured
    warm_up : sweeps over which steps of the geometry grow to their full length; measured against 0 and against a
        geometry that is held for 0.3 sweeps
    prior : strength lambda of the voxel prior, its information over that of the data [no unit]; measured against 0 and
        0.1; 0 starts from decomposed rays instead, further off, and wants larger rates
    steps_along_edges : trust in the volumes along edges times the number of steps, because many steps find edges better
        than voxels do and few do not; measured against 1.8, 54 and no limit
    information_step : views between two whose rays give the mean information of the line integrals; chosen by hand, not
        measured
    margin_air : voxels of air around the object in a grid that was enlarged, where Gaussians may be placed; chosen by
        hand, not measured
    seed : of the placement, of the order of views, and of which are held out
    held_out : training views that are not fitted; the fit ends when chi-square on them no longer falls; 0 for none
    placement : how the first Gaussians are placed
    surfaces : how Gaussians that planes divide are placed
    volume_fit : how they are fitted to the voxel volumes
    voxel_prior : how the voxel prior is evaluated
    optimizer : how steps are made and when they end
    unseen_rays : which rays no part of a fit uses, and when they decide
    residual : what voxels take of that which Gaussians leave unexplained
    curve : materials of the object; then coefficients stay on their curve (`recon.gaussians.on_curve`), and one
        channel determines them; None for coefficients of all bases
    """

    name: str = "own"
    kernel: str = "gaussian"
    stages: tuple[Stage, ...] = (Stage(0.5, 1.0),)
    views_per_step: int = 1
    most_turns: float = 1.0
    few_views: int = 75
    spacing: float = 1.0
    finest_spacing: float = 0.9
    voxel_passes: int = 6
    voxel_fall: float = 0.01
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
    information_step: int = 8
    margin_air: int = 3
    seed: int = 0
    held_out: int = 0
    placement: PlacementSettings = field(default_factory=PlacementSettings)
    surfaces: SurfaceSettings = field(default_factory=SurfaceSettings)
    volume_fit: VolumeFitSettings = field(default_factory=VolumeFitSettings)
    voxel_prior: PriorSettings = field(default_factory=PriorSettings)
    optimizer: OptimizerSettings = field(default_factory=OptimizerSettings)
    unseen_rays: UnseenRaysSettings = field(default_factory=UnseenRaysSettings)
    residual: ResidualSettings = field(default_factory=ResidualSettings)
    curve: MaterialCurve | None = None

    def __post_init__(self) -> None:
        check_positive(self, "recipe", others=_ANY_SIGN)
        if self.held_out < 0:
            raise InputError(f"recipe held_out must be a number of views, 0 or more, got {self.held_out}")
        if not self.stages:
            raise InputError("a recipe needs at least one stage")
        if self.kernel not in KERNELS:
            raise InputError(f"recipe kernel must be {' or '.join(KERNELS)}, got {self.kernel}")
        if self.curve is not None and (self.kernel != "interface" or not self.prior or self.residual.passes):
            raise InputError(
                "Gaussians on a curve of materials need the kernel interface and a voxel prior, and take no residual"
            )

    def steps(self, views: int) -> list[int]:
        """Count the steps of each stage.

        Parameters
        ----------
        views : training views of each kind

        Returns
        -------
        numbers of steps, at least 1 each
        """
        more = min(max(self.few_views / views, 1.0), self.most_turns)
        return [max(round(stage.sweeps * self.per_sweep(views) * more), 1) for stage in self.stages]

    def per_sweep(self, views: int) -> int:
        """Count the steps of one sweep over all views.

        Parameters
        ----------
        views : training views of each kind

        Returns
        -------
        number of steps, at least 1
        """
        return max(views // self.views_per_step, 1)

    def curvature_steps(self, views: int) -> int:
        """Count the steps between two computations of the coefficients' curvature.

        Parameters
        ----------
        views : training views of each kind

        Returns
        -------
        number of steps, at least 1
        """
        return max(round(self.curvature_sweeps * self.per_sweep(views)), 1)

    def distance(self, views: int) -> float:
        """Choose the distance between Gaussians along edges: with more views, finer structures exceed the noise.

        Parameters
        ----------
        views : training views

        Returns
        -------
        distance [voxels]
        """
        return min(self.spacing, max(self.spacing * (self.few_views / views) ** (1 / 6), self.finest_spacing))

    def prior_along_edges(self, views: int) -> float:
        """Choose the trust in the volumes along edges, over that far from edges.

        Parameters
        ----------
        views : training views of each kind

        Returns
        -------
        trust, 0 to 1
        """
        return min(self.steps_along_edges / sum(self.steps(views)), 1.0)


FAST = Recipe(name="fast", kernel="interface", most_turns=4.0, stages=(Stage(0.5, 3.0),), approximation=100)
BEST = Recipe(
    name="best",
    kernel="interface",
    most_turns=4.0,
    stages=(Stage(0.5, 12.0),),
    approximation=150,
    surfaces=SurfaceSettings(spacing=0.5, finest=1.0),
)
PLAIN_FAST = Recipe(name="fast", most_turns=4.0)
PLAIN_BEST = Recipe(name="best", most_turns=4.0, stages=(Stage(0.5, 4.0),), spacing=0.9)
RECIPES = {recipe.name: recipe for recipe in (FAST, BEST)}
PLAIN_RECIPES = {recipe.name: recipe for recipe in (PLAIN_FAST, PLAIN_BEST)}


def with_detail(recipe: Recipe, detail: float) -> Recipe:
    """Place Gaussians closer to each other, or further apart.

    Parameters
    ----------
    recipe : the recipe
    detail : factor by which all distances between Gaussians shrink

    Returns
    -------
    a recipe with other distances
    """
    if detail == 1:
        return recipe
    surfaces = recipe.surfaces
    closer = {name: getattr(surfaces, name) / detail for name in ("spacing", "finest", "coarsest")}
    return replace(
        recipe,
        spacing=recipe.spacing / detail,
        finest_spacing=recipe.finest_spacing / detail,
        surfaces=replace(surfaces, **closer),
    )


def with_residual_in_voxels(recipe: Recipe, passes: int = RESIDUAL_PASSES) -> Recipe:
    """Let voxels take what Gaussians leave unexplained.

    Parameters
    ----------
    recipe : the recipe
    passes : passes over the views

    Returns
    -------
    a recipe whose fit ends with a residual in voxels
    """
    return replace(recipe, residual=replace(recipe.residual, passes=passes))


def with_count(recipe: Recipe, count: int) -> Recipe:
    """Place about as many Gaussians as are wanted.

    Parameters
    ----------
    recipe : the recipe
    count : number of Gaussians, within 1 % above a few hundred; 0 for as many as the distances give

    Returns
    -------
    a recipe whose distances between Gaussians get the factor that this takes
    """
    placement, surfaces = replace(recipe.placement, count=count), replace(recipe.surfaces, count=count)
    return replace(recipe, placement=placement, surfaces=surfaces)
