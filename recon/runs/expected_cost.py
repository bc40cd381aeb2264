"""What a fit will take: it is begun, a few steps are timed, and nothing is kept."""

from dataclasses import asdict, dataclass
from math import ceil
from typing import Any

from phantomgen.dataset.reader import Dataset
from recon.data.view_subsets import kinds_of, rounds_of
from recon.gaussians.optimize import Progress
from recon.gaussians.processes import Resources
from recon.gaussians.recipe import Recipe
from recon.gaussians.reconstruct import reconstruct
from recon.runs.memory_plan import MemoryPlan, plan_memory

TIMED_STEPS = 3


@dataclass(frozen=True)
class ExpectedCost:
    """Of a fit.

    Parameters
    ----------
    gaussians : that it starts with
    voxels : along z, y and x of the grid that is fitted, with the margin of a truncated scan
    steps : that it makes
    start_seconds, fit_seconds : of the start, and of all steps; without scores and figures
    memory : expected peak
    """

    gaussians: int
    voxels: tuple[int, int, int]
    steps: int
    start_seconds: float
    fit_seconds: float
    memory: MemoryPlan

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
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
    """Make the start and a few steps, and say what all of them will take.

    Parameters
    ----------
    dataset : an open dataset
    recipe : hyper-parameters
    bases : how many basis functions to fit, default all
    limit : largest memory to take [GiB], None for no limit
    device : where Gaussians are computed
    """
    plan_memory(dataset, recipe, bases, limit)
    timed: list[Progress] = []

    def on_step(progress: Progress) -> bool:
        timed.append(progress)
        return len(timed) == TIMED_STEPS

    result = reconstruct(dataset, recipe, bases, on_step=on_step, resources=Resources(device=device))
    count, grid = len(result.gaussians), result.coverage.grid if result.coverage else dataset.grid
    rounds = rounds_of(kinds_of(dataset.exposure[dataset.splits["train"][recipe.held_out :]]))
    start = sum(seconds for name, seconds in result.seconds.items() if name != "fit")
    return ExpectedCost(
        count,
        grid.shape,
        timed[-1].steps,
        start,
        seconds_of_steps(timed, recipe, rounds),
        plan_memory(dataset, recipe, bases, limit, count, grid),
    )


def seconds_of_steps(timed: list[Progress], recipe: Recipe, views: int) -> float:
    """Seconds of all steps over so many views of each kind, from the first, which finds curvature, too, and more."""
    first, last = timed[0].seconds, timed[-1].seconds
    plain = (last - first) / (len(timed) - 1) if len(timed) > 1 else first
    renewals = sum(ceil(steps / recipe.curvature_steps(views)) for steps in recipe.steps(views))
    return plain * timed[-1].steps + max(first - plain, 0.0) * renewals
