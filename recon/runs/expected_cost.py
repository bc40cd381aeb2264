"""Time and memory that a fit will take: the start and a few steps are timed, and the results are discarded."""

from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

from phantomgen.dataset.reader import Dataset
from recon.data.view_subsets import count_complete_sets, view_groups
from recon.gaussians.optimize import Progress
from recon.gaussians.processes import Resources
from recon.gaussians.recipe import Recipe
from recon.gaussians.reconstruct import reconstruct
from recon.runs.memory_plan import MemoryPlan, plan_memory

TIMED_STEPS = 3  # steps; the first also computes the curvature, the others give the time of a plain step


@dataclass(frozen=True)
class ExpectedCost:
    """Expected time and memory of a fit.

    Parameters
    ----------
    gaussians : number at the start
    voxels : number along z, y and x of the grid that is fitted, with the margin of a truncated scan
    steps : number of steps of the fit
    start_seconds, fit_seconds : time of the start, and of all steps [s]; scores and figures come on top
    memory : expected peak
    """

    gaussians: int
    voxels: tuple[int, int, int]
    steps: int
    start_seconds: float
    fit_seconds: float
    memory: MemoryPlan

    def to_dict(self) -> dict[str, Any]:
        """Return the values for JSON.

        Returns
        -------
        values by name
        """
        return asdict(self) | {"memory": {"peak_gib": self.memory.peak, **asdict(self.memory)}}

    def __str__(self) -> str:
        total = self.start_seconds + self.fit_seconds
        return (
            f"{self.gaussians} Gaussians, {self.steps} steps, {' x '.join(map(str, self.voxels))} voxels\n"
            f"about {total:.0f} s: start {self.start_seconds:.0f} s, steps {self.fit_seconds:.0f} s\n"
            f"about {self.memory}"
        )


def expected_cost(
    dataset: Dataset, recipe: Recipe, bases: int | None, limit: float | None, device: str = "cpu"
) -> ExpectedCost:
    """Time the start and a few steps, and extrapolate to the whole fit.

    Parameters
    ----------
    dataset : open dataset
    recipe : hyper-parameters
    bases : number of basis functions to fit; None for all
    limit : largest memory to take [GiB]; None for no limit
    device : where Gaussians are computed, ``cpu`` or ``cuda``

    Returns
    -------
    expected time and memory

    Raises
    ------
    InputError
        When the limit of memory cannot be kept.
    """
    plan_memory(dataset, recipe, bases, limit)
    timed: list[Progress] = []

    def on_step(progress: Progress) -> bool:
        timed.append(progress)
        return len(timed) == TIMED_STEPS

    result = reconstruct(dataset, recipe, bases, on_step=on_step, resources=Resources(device=device))
    count, grid = len(result.gaussians), result.coverage.grid if result.coverage else dataset.grid
    complete_sets = count_complete_sets(view_groups(dataset.exposure[dataset.splits["train"][recipe.held_out :]]))
    start = sum(seconds for name, seconds in result.seconds.items() if name != "fit")
    return ExpectedCost(
        count,
        grid.shape,
        timed[-1].steps,
        start,
        seconds_of_steps(timed, recipe, complete_sets),
        plan_memory(dataset, recipe, bases, limit, count, grid),
    )


def seconds_of_steps(timed: list[Progress], recipe: Recipe, views: int) -> float:
    """Extrapolate the time of all steps from that of the first ones.

    Parameters
    ----------
    timed : first steps; the very first also computes the curvature
    recipe : hyper-parameters
    views : number of views of each kind that are fitted

    Returns
    -------
    time of all steps [s]
    """
    first, last = timed[0].seconds, timed[-1].seconds
    plain = (last - first) / (len(timed) - 1) if len(timed) > 1 else first
    renewals = sum(ceil(steps / recipe.curvature_steps(views)) for steps in recipe.steps(views))
    return plain * timed[-1].steps + max(first - plain, 0.0) * renewals
