"""Timed fits of Gaussians: one run for each budget, as learning rates and stages depend on the length of a fit.

The start and a few steps are timed first. For each budget, the fit of `recon fit` then begins with that start and makes
as many sweeps as the rest of the budget allows; the paper's method repeats its start while the clock is stopped. The
time of a sweep is extrapolated from the first steps. A fit that still exceeds its budget is ended there. Where the
start alone exceeds a budget, Gaussians are fitted to the voxel volumes for as long as the budget allows, and not to the
counts.
"""

from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset
from recon.comparison.contenders.clock import BudgetSpent, Clock
from recon.comparison.contenders.contender import Contender
from recon.comparison.contenders.model import Model, Runs
from recon.comparison.contenders.recorder import Recorder
from recon.data.measurements import Measurements
from recon.gaussians.divided.model_file import load_model
from recon.gaussians.optimize import Progress
from recon.gaussians.recipe import BEST, FAST, PLAIN_BEST, PLAIN_FAST
from recon.gaussians.reconstruct import reconstruct
from recon.gaussians.state import FitState, InterruptedFit
from recon.kedge.basis_names import OnCurve
from recon.kedge.choose_basis import choose_basis
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.reconstruct import reconstruct_paper
from recon.runs.expected_cost import TIMED_STEPS, seconds_of_steps
from recon.runs.run_gaussians import on_curve

RESERVE = 0.95  # part of the rest of a budget that is planned; the rest allows for steps slower than the first ones
GROWTH = 2.0  # ratio of the mean time of a step of the paper's method to that of its first steps: it adds Gaussians
LATE = 0.9  # part of a budget from which on the model of every step is kept

NewRecorder = Callable[[list[float]], Recorder]


@dataclass
class _Beginning:
    """Common start of all fits of a contender, a `recon.gaussians.reconstruct.CheckpointStore` in memory."""

    clock: Clock
    following: float | None = None
    seconds: float | None = None
    volumes: np.ndarray = field(default_factory=lambda: np.empty(0))
    state: tuple[dict[str, Any], dict[str, Any]] | None = None

    def stage(self, name: str) -> None:
        """Set the clock to the time at the end of the first start when a later fit begins."""
        if name == "approximate":
            self.following = self.clock.seconds()
        if name != "fit":
            return
        if self.seconds is None:
            self.seconds = self.clock.seconds()
        else:
            self.clock.start(self.seconds)

    def found(self, measured: Measurements) -> InterruptedFit | None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del measured
        if self.state is None:
            return None
        return InterruptedFit(FitState.restore(*deepcopy(self.state)), self.volumes, {})

    def begin(self, volumes: np.ndarray, seconds: dict[str, float], state: FitState) -> None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del seconds
        with self.clock.paused():
            self.volumes, self.state = volumes, deepcopy((state.tensors(), state.numbers()))


def run_gaussian(dataset: Dataset, contender: Contender, clock: Clock, new: NewRecorder, budgets: list[float]) -> Runs:
    """Run the fit of `recon fit` for each budget, at most as long as its recipe.

    Parameters
    ----------
    dataset : open dataset, restricted to what the contender may use; only ``/entry`` is read
    contender : recipe and number of bases
    clock : of all runs
    new : creates the recorder for some budgets
    budgets : [s]

    Returns
    -------
    the runs
    """
    clock.start()
    bases = OnCurve() if contender.on_curve else contender.bases
    dataset = dataset.with_basis(choose_basis(dataset, bases).basis)
    recipes = (PLAIN_FAST, PLAIN_BEST) if contender.plain else (FAST, BEST)
    recipe, beginning = on_curve(recipes[contender.best], bases, dataset), _Beginning(clock)
    timed = _Timed(beginning)
    reconstruct(dataset, recipe, on_stage=beginning.stage, on_step=timed, checkpoints=beginning)
    clock.stop()
    start = beginning.seconds or 0.0
    needed = seconds_of_steps(timed.steps, recipe, len(dataset.splits["train"]) - recipe.held_out)
    shares = {budget: min(RESERVE * (budget - start) / needed, 1.0) for budget in sorted(budgets)}

    def fit(share: float, recorder: Recorder) -> None:
        stages = tuple(replace(stage, sweeps=share * stage.sweeps) for stage in recipe.stages)
        shorter = replace(recipe, stages=stages)
        reconstruct(dataset, shorter, on_stage=beginning.stage, on_step=_Kept(recorder), checkpoints=beginning)

    def follow(budget: float) -> Recorder:
        recorder, following = new([budget]), beginning.following or start
        part = (RESERVE * budget - following) / max(start - following, 1e-9)
        if (evaluations := int(part * recipe.approximation)) > 0:
            clock.start(0.0)
            with suppress(BudgetSpent):
                reconstruct(dataset, replace(recipe, approximation=evaluations), checkpoints=_Unfitted(recorder))
            clock.stop()
        return recorder

    runs = _run_all(shares, fit, clock, new, f"the start alone takes {start:.3g} s")
    unfitted = [follow(budget) for budget, share in shares.items() if share <= 0]
    return replace(runs, recorders=(*runs.recorders, *unfitted))


def run_paper(dataset: Dataset, contender: Contender, clock: Clock, new: NewRecorder, budgets: list[float]) -> Runs:
    """Run the paper's method for each budget, at most as long as its recipe.

    Parameters
    ----------
    dataset : open dataset, restricted to what the contender may use; only ``/entry`` is read
    contender : number of bases, and components that are switched off
    clock : of all runs
    new : creates the recorder for some budgets
    budgets : [s]

    Returns
    -------
    the runs
    """
    recipe, beginning = PaperRecipe(without=contender.without), _Beginning(clock)
    timed = _Timed(beginning)
    clock.start()
    reconstruct_paper(dataset, recipe, contender.bases, beginning.stage, timed)
    clock.stop()
    start = beginning.seconds or 0.0
    first, last = timed.steps[0].seconds, timed.steps[-1].seconds
    needed = GROWTH * recipe.steps * (last - first) / (len(timed.steps) - 1)
    shares = {budget: min(RESERVE * (budget - start) / needed, 1.0) for budget in sorted(budgets)}

    def fit(share: float, recorder: Recorder) -> None:
        shorter = replace(recipe, steps=max(round(share * recipe.steps), 1))
        reconstruct_paper(dataset, shorter, contender.bases, beginning.stage, _Kept(recorder))

    return _run_all(shares, fit, clock, new, f"the start alone takes {start:.3g} s")


def _run_all(
    shares: dict[float, float], fit: Callable[[float, Recorder], None], clock: Clock, new: NewRecorder, lacking: str
) -> Runs:
    """Run once for each budget that allows a part of the recipe, and once for all that allow the whole."""
    whole = [budget for budget, share in shares.items() if share >= 1]
    groups = [([budget], share) for budget, share in shares.items() if 0 < share < 1]
    recorders = []
    for budgets, share in [*groups, *([(whole, 1.0)] if whole else [])]:
        recorder = new(budgets)
        with suppress(BudgetSpent):
            fit(share, recorder)
            recorder.finished = True
        clock.stop()
        recorders.append(recorder)
    return Runs(tuple(recorders), _load, lacking)


@dataclass
class _Timed:
    """Callback that notes the first steps, with their time by the clock of the comparison, and ends the fit."""

    beginning: _Beginning
    steps: list[Progress] = field(default_factory=list)

    def __call__(self, progress: Progress) -> bool:
        seconds = self.beginning.clock.seconds() - (self.beginning.seconds or 0.0)
        self.steps.append(replace(progress, seconds=seconds))
        return len(self.steps) == TIMED_STEPS


@dataclass
class _Kept:
    """Callback that records some models, and each one towards the end of a budget."""

    recorder: Recorder

    def __call__(self, progress: Progress) -> None:
        late = self.recorder.clock.seconds() > LATE * self.recorder.budgets[0]
        if progress.snapshot or late:
            self.recorder.add(progress.step, progress.steps, progress.gaussians.save)


@dataclass
class _Unfitted:
    """CheckpointStore that records the start of a fit, and ends the fit there."""

    recorder: Recorder

    def found(self, measured: Measurements) -> None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del measured

    def begin(self, volumes: np.ndarray, seconds: dict[str, float], state: FitState) -> None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del volumes, seconds
        self.recorder.add(0, 1, state.gaussians.save)
        raise BudgetSpent


def _load(path: Path) -> Model:
    return Model(load_model(path))
