"""Fits of Gaussians against the clock: a run of its own for each budget, as rates and stages depend on its length.

The start and a few steps are timed first. The fit of `recon fit` then begins at that start for each budget, with so
many sweeps as fit into what is left; the paper's method repeats its start while the clock stands still. Forecasts are
from the seconds of the first steps. A fit that would still pass its budget is cut there. Where a budget holds no start,
Gaussians follow voxels for as long as it allows, and are not fitted.
"""

from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset
from recon.comparison.contenders.clock import Clock, Spent
from recon.comparison.contenders.contender import Contender
from recon.comparison.contenders.model import Model, Runs
from recon.comparison.contenders.recorder import Recorder
from recon.data.measurements import Measurements
from recon.gaussians.model import Gaussians
from recon.gaussians.optimize import Progress
from recon.gaussians.recipe import BEST, FAST
from recon.gaussians.reconstruct import reconstruct
from recon.gaussians.state import FitState, InterruptedFit
from recon.kedge.choose_basis import choose_basis
from recon.published_methods.paper.recipe import PaperRecipe
from recon.published_methods.paper.reconstruct import reconstruct_paper
from recon.runs.expected_cost import TIMED_STEPS, seconds_of_steps

RESERVE = 0.95  # of what is left of a budget is planned for
GROWTH = 2.0  # later steps of the paper's method take so much longer: it adds Gaussians
LATE = 0.9  # from this part of a budget on every step is kept

NewRecorder = Callable[[list[float]], Recorder]


@dataclass
class _Beginning:
    """Where all fits of a contender begin; keeps the first, and hands it to the others."""

    clock: Clock
    following: float | None = None
    seconds: float | None = None
    volumes: np.ndarray = field(default_factory=lambda: np.empty(0))
    state: tuple[dict[str, Any], dict[str, Any]] | None = None

    def stage(self, name: str) -> None:
        """The clock runs on from the end of the start when a fit begins, however long it took to get there again."""
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
        with self.clock.standing():
            self.volumes, self.state = volumes, deepcopy((state.tensors(), state.numbers()))


def run_gaussian(dataset: Dataset, contender: Contender, clock: Clock, new: NewRecorder, budgets: list[float]) -> Runs:
    """The fit of `recon fit`, at most as long as its recipe says.

    Parameters
    ----------
    dataset : an open dataset, restricted to what the contender may see; only ``/entry`` is read
    contender : says how many bases
    clock : of all runs
    new : makes the recorder of some budgets
    budgets : [s]
    """
    clock.start()
    dataset = dataset.with_basis(choose_basis(dataset, contender.bases).basis)
    recipe, beginning = BEST if contender.best else FAST, _Beginning(clock)
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
            with suppress(Spent):
                reconstruct(dataset, replace(recipe, approximation=evaluations), checkpoints=_Unfitted(recorder))
            clock.stop()
        return recorder

    runs = _run_all(shares, fit, clock, new, f"the start alone takes {start:.3g} s")
    unfitted = [follow(budget) for budget, share in shares.items() if share <= 0]
    return replace(runs, recorders=(*runs.recorders, *unfitted))


def run_paper(dataset: Dataset, contender: Contender, clock: Clock, new: NewRecorder, budgets: list[float]) -> Runs:
    """The paper's method; parameters as of `run_gaussian`."""
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
    """A run for each budget that holds a part of the recipe, and one for all that hold the whole."""
    whole = [budget for budget, share in shares.items() if share >= 1]
    groups = [([budget], share) for budget, share in shares.items() if 0 < share < 1]
    recorders = []
    for budgets, share in [*groups, *([(whole, 1.0)] if whole else [])]:
        recorder = new(budgets)
        with suppress(Spent):
            fit(share, recorder)
            recorder.finished = True
        clock.stop()
        recorders.append(recorder)
    return Runs(tuple(recorders), _load, lacking)


@dataclass
class _Timed:
    """Callback that lets a few steps pass, with their seconds by the clock of the comparison."""

    beginning: _Beginning
    steps: list[Progress] = field(default_factory=list)

    def __call__(self, progress: Progress) -> bool:
        seconds = self.beginning.clock.seconds() - (self.beginning.seconds or 0.0)
        self.steps.append(replace(progress, seconds=seconds))
        return len(self.steps) == TIMED_STEPS


@dataclass
class _Kept:
    """Callback that records what counts: some models along the way, and every one towards the end of a budget."""

    recorder: Recorder

    def __call__(self, progress: Progress) -> None:
        late = self.recorder.clock.seconds() > LATE * self.recorder.budgets[0]
        if progress.snapshot or late:
            self.recorder.add(progress.step, progress.steps, progress.gaussians.save)


@dataclass
class _Unfitted:
    """CheckpointStore that records what a fit begins with, and ends it there."""

    recorder: Recorder

    def found(self, measured: Measurements) -> None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del measured

    def begin(self, volumes: np.ndarray, seconds: dict[str, float], state: FitState) -> None:
        """See `recon.gaussians.reconstruct.CheckpointStore`."""
        del volumes, seconds
        self.recorder.add(0, 1, state.gaussians.save)
        raise Spent


def _load(path: Path) -> Model:
    return Model(Gaussians.load(path))
