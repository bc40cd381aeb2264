"""Every number of the paper's method, when each part acts, and which parts can be switched off (table 4c)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from spectra.errors import InputError

PAPER_STEPS = 30_000
IODINE_EDGE = 33.1694  # keV


@dataclass(frozen=True)
class Rate:
    """Learning rate that falls exponentially from `first` to `last` over the fit."""

    first: float
    last: float


@dataclass(frozen=True)
class PaperRecipe:
    """Hyper-parameters of the paper; what it does not state is R2-Gaussian's, or marked as our choice.

    Lengths are in units of half the grid's longest edge and densities in units of the start's highest, as R2-Gaussian's
    numbers presume. Counts of steps are those of a fit of 30 000 steps; `scaled` shrinks them with `steps`.

    Parameters
    ----------
    steps : Adam steps, one view each
    without : components that are switched off, see `COMPONENTS`
    seed : of the first Gaussians, the order of views, split offsets and patches
    gaussians, most : Gaussians at the start and at most
    lowest_energy, highest_energy, energies : midpoint rule over energy [keV]
    dssim, volume_tv, image_tv : weights of the loss terms (eq. 8)
    patch : edge of the random sub-volume whose total variation is taken [voxel] (R2-Gaussian)
    emptiest : density that a voxel needs to get a Gaussian (R2-Gaussian)
    density_share : density of a Gaussian over that of its voxel at the start (R2-Gaussian)
    narrowest, widest : bounds of standard deviations over the grid's longest edge (R2-Gaussian)
    centre_rate, density_rate, scale_rate, rotation_rate : of Adam (R2-Gaussian)
    fraction_rate : twice that of the density; the paper says 'higher' (our choice)
    edge_start : first energy of the K edge, that of iodine [keV]
    edge_slope : first gamma of the K edge [1/keV] (our choice)
    edge_rate, edge_shape_rate : Adam's steps of the edge's energy [keV], and of log amplitude and slope (our choice)
    edge_freeze : steps before the K edge moves
    densify_from, densify_until, densify_every : when Gaussians are added and pruned (R2-Gaussian)
    clone_gradient : mean gradient in normalised detector coordinates that clones a small Gaussian (R2-Gaussian)
    split_gradient : the same that splits a large one (our choice)
    large : standard deviation above which a Gaussian is large, over the grid's longest edge (R2-Gaussian)
    least_density : below it a Gaussian is pruned (R2-Gaussian)
    fraction_reset : steps between two resets of the fractions (3D Gaussian splatting's opacity resets)
    """

    steps: int = PAPER_STEPS
    without: tuple[str, ...] = ()
    seed: int = 0
    gaussians: int = 50_000
    most: int = 500_000
    lowest_energy: float = 20.0
    highest_energy: float = 140.0
    energies: int = 64
    dssim: float = 0.25
    volume_tv: float = 0.005
    image_tv: float = 0.05
    patch: int = 32
    emptiest: float = 0.05
    density_share: float = 0.15
    narrowest: float = 0.0005
    widest: float = 0.5
    centre_rate: Rate = Rate(2e-4, 2e-5)
    density_rate: Rate = Rate(1e-2, 1e-3)
    scale_rate: Rate = Rate(5e-3, 5e-4)
    rotation_rate: Rate = Rate(1e-3, 1e-4)
    fraction_rate: Rate = Rate(2e-2, 2e-3)
    edge_start: float = IODINE_EDGE
    edge_slope: float = 1.0
    edge_rate: float = 0.02
    edge_shape_rate: float = 1e-3
    edge_freeze: int = 2000
    densify_from: int = 500
    densify_until: int = 15_000
    densify_every: int = 100
    clone_gradient: float = 5e-5
    split_gradient: float = 2.5e-5
    large: float = 0.1
    least_density: float = 1e-5
    fraction_reset: int = 3000

    def __post_init__(self) -> None:
        object.__setattr__(self, "without", checked(self.without))
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, int | float) and field.name != "seed" and value <= 0:
                raise InputError(f"recipe {field.name} must be positive, got {value}")

    def uses(self, component: str) -> bool:
        """Whether a component is switched on."""
        return component not in self.without

    def scaled(self, steps: int) -> int:
        """Steps of the paper's 30 000 as steps of this fit, at least one."""
        return max(round(steps * self.steps / PAPER_STEPS), 1)

    @property
    def says(self) -> str:
        """How long the fit is beside the paper's, and what it leaves out: one line."""
        share = "" if self.steps == PAPER_STEPS else f" in place of {PAPER_STEPS}, all schedules scaled to match"
        left_out = f"; without {', '.join(self.without)}" if self.without else ""
        return f"recipe of the paper: {self.steps} steps{share}{left_out}"


def is_due(step: int, interval: int, recipe: PaperRecipe) -> bool:
    """Whether something that happens at an interval of the paper's steps, until densification ends, happens now."""
    return step < recipe.scaled(recipe.densify_until) and step % recipe.scaled(interval) == 0


def views_in_random_order(count: int, seed: int) -> Iterator[int]:
    """Every view once in random order, again and again."""
    rng = np.random.default_rng([seed, 2])
    while True:
        yield from rng.permutation(count).tolist()


COMPONENTS = {
    "kedge-freezing": "parameters of the K edge rest at first (table 4c)",
    "tv": "both total variations (table 4c)",
    "split-threshold": "a threshold of its own for splitting (table 4c); one for both without",
    "polychromatic": "the integral over energy (table 4c); one energy per channel without",
    "local-affine": "the footprint of R2-Gaussian; the exact line integral without",
    "volume-tv": "total variation of the channels' volumes",
    "image-tv": "total variation of the bases' projections",
    "dssim": "structural dissimilarity beside L1",
    "conditioning": "the K-edge column made orthogonal to the other two",
    "kedge-learning": "the K edge follows the gradient; it stays where it starts without",
    "kedge-gate": "dense Gaussians start with more K edge; all with the same part of photoelectric without",
    "fraction-start": "first fractions from density; equal ones without",
    "fraction-reset": "fractions are drawn back to the middle from time to time",
    "fraction-rate": "fractions learn faster than density; as fast without",
    "rate-decay": "learning rates fall; they stay without",
    "densification": "Gaussians are cloned and split",
    "pruning": "Gaussians without density or outside the grid are removed",
}


def checked(names: Iterable[str]) -> tuple[str, ...]:
    """Names of components, each once, in the order of `COMPONENTS`.

    Raises
    ------
    InputError
        When there is no such component; the sentence lists those that there are.
    """
    wanted = set(names)
    unknown = sorted(wanted - set(COMPONENTS))
    if unknown:
        raise InputError(f"--without {unknown[0]}: there is no such component; choose from {', '.join(COMPONENTS)}")
    return tuple(name for name in COMPONENTS if name in wanted)
