"""All numbers of the paper's method, the step at which each component acts, and the names of components (table 4c)."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from spectra.errors import InputError

PAPER_STEPS = 30_000  # steps; length of a fit in the paper and in R2-Gaussian
IODINE_EDGE = 33.1694  # keV; K edge of iodine, the paper's first value


@dataclass(frozen=True)
class Rate:
    """Learning rate that decreases exponentially during the fit.

    Parameters
    ----------
    first : learning rate at the first step
    last : learning rate at the last step
    """

    first: float
    last: float


@dataclass(frozen=True)
class PaperRecipe:
    """Hyper-parameters of the paper; what it does not state is R2-Gaussian's, or is marked as our choice.

    Lengths are in units of half the grid's longest edge and densities in units of the highest initial density, as
    R2-Gaussian's numbers assume. Numbers of steps are those of a fit of 30 000; `scaled` converts them to `steps`.

    Parameters
    ----------
    steps : Adam steps, one view each
    without : components that are switched off, see `COMPONENTS`
    seed : seed of the first Gaussians, the order of views, offsets of split Gaussians, and patches
    gaussians, most : number of Gaussians at the start, and largest number
    lowest_energy, highest_energy, energies : limits [keV] and number of points of the midpoint rule over energy
    dssim, volume_tv, image_tv : weights of the terms of the loss (eq. 8)
    patch : edge of the random sub-volume whose total variation is computed [voxel] (R2-Gaussian)
    emptiest : density above which a voxel may get a Gaussian (R2-Gaussian)
    density_share : density of a Gaussian over that of its voxel at the start (R2-Gaussian)
    narrowest, widest : bounds of standard deviations over the grid's longest edge (R2-Gaussian)
    centre_rate, density_rate, scale_rate, rotation_rate : learning rates of Adam (R2-Gaussian)
    fraction_rate : learning rate of the fractions, twice that of the density; the paper says 'higher' (our choice)
    edge_start : initial energy of the K edge, that of iodine [keV]
    edge_slope : initial gamma of the K edge [1/keV] (our choice)
    edge_rate, edge_shape_rate : learning rates of the edge energy [keV] and of log amplitude and slope (our choice)
    edge_freeze : steps before the K edge is fitted
    densify_from, densify_until, densify_every : first step, last step and interval of density control (R2-Gaussian)
    clone_gradient : mean gradient in normalised detector coordinates that clones a small Gaussian (R2-Gaussian)
    split_gradient : mean gradient that splits a large Gaussian (our choice)
    large : standard deviation above which a Gaussian is large, over the grid's longest edge (R2-Gaussian)
    least_density : density below which a Gaussian is removed (R2-Gaussian)
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
        """Report whether a component is switched on.

        Parameters
        ----------
        component : a name of `COMPONENTS`

        Returns
        -------
        True when the component is used
        """
        return component not in self.without

    def scaled(self, steps: int) -> int:
        """Convert a number of steps of the paper's 30 000 to this fit.

        Parameters
        ----------
        steps : number of steps in a fit of 30 000

        Returns
        -------
        number of steps in this fit, at least 1
        """
        return max(round(steps * self.steps / PAPER_STEPS), 1)

    @property
    def description(self) -> str:
        """Sentence on the length of the fit, compared with the paper's, and on the components that are left out."""
        share = "" if self.steps == PAPER_STEPS else f" in place of {PAPER_STEPS}, all schedules scaled to match"
        left_out = f"; without {', '.join(self.without)}" if self.without else ""
        return f"recipe of the paper: {self.steps} steps{share}{left_out}"


def is_due(step: int, interval: int, recipe: PaperRecipe) -> bool:
    """Report whether something that happens at an interval happens at this step.

    Parameters
    ----------
    step : step of this fit, from 1
    interval : interval in steps of a fit of 30 000
    recipe : recipe of the fit

    Returns
    -------
    True at multiples of the interval, while density control lasts
    """
    return step < recipe.scaled(recipe.densify_until) and step % recipe.scaled(interval) == 0


def views_in_random_order(count: int, seed: int) -> Iterator[int]:
    """Yield the views in random order; every view comes once before any view comes again.

    Parameters
    ----------
    count : number of views
    seed : seed of the order

    Yields
    ------
    indices of views, without end
    """
    rng = np.random.default_rng([seed, 2])
    while True:
        yield from rng.permutation(count).tolist()


COMPONENTS = {
    "kedge-freezing": "the K edge is constant at first (table 4c)",
    "tv": "both total variations (table 4c)",
    "split-threshold": "a separate threshold for splitting (table 4c); without: one for both",
    "polychromatic": "the integral over energy (table 4c); without: one energy per channel",
    "local-affine": "the footprint of R2-Gaussian; without: the exact line integral",
    "volume-tv": "total variation of the channels' volumes",
    "image-tv": "total variation of the bases' projections",
    "dssim": "structural dissimilarity beside L1",
    "conditioning": "the K-edge column is made orthogonal to the other two",
    "kedge-learning": "the K edge is fitted; without: it stays where it starts",
    "kedge-gate": "dense Gaussians start with more K edge; without: all with the same part of photoelectric",
    "fraction-start": "first fractions depend on density; without: they are equal",
    "fraction-reset": "fractions are averaged with equal ones at intervals",
    "fraction-rate": "fractions have a higher learning rate than density; without: the same",
    "rate-decay": "learning rates decrease; without: they are constant",
    "densification": "Gaussians are cloned and split",
    "pruning": "Gaussians of nearly no density or outside the grid are removed",
}


def checked(names: Iterable[str]) -> tuple[str, ...]:
    """Check and sort names of components.

    Parameters
    ----------
    names : names of components

    Returns
    -------
    each name once, in the order of `COMPONENTS`

    Raises
    ------
    InputError
        When a component does not exist; the sentence lists all components.
    """
    wanted = set(names)
    unknown = sorted(wanted - set(COMPONENTS))
    if unknown:
        raise InputError(f"--without {unknown[0]}: there is no such component; choose from {', '.join(COMPONENTS)}")
    return tuple(name for name in COMPONENTS if name in wanted)
