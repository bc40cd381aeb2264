"""Score of a volume of any program: the same scores, figures and files as those of a run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.runtime.guarded import Guard, WarnOnFailure, unguarded
from phantomgen.runtime.plain_json import write_json
from phantomgen.runtime.stopwatch import Stopwatch, peak_memory_mib
from phantomgen.runtime.versions import environment
from recon.data.measurements import read_measurements
from recon.evaluation.scoring import score_truth
from recon.evaluation.stated_volume import StatedVolume, Statement, stated_volume
from recon.figures.model_figures import draw_volumes
from recon.kedge.basis_names import left_out, named_basis
from recon.runs.outcomes.volume_outcome import VolumeOutcome
from recon.runs.run_folder import VOLUMES
from recon.runs.write_run import RunFolder, write_volumes
from spectra.threads import without_other_pools

_DRAWN_IN = {"density": "mg cm$^{-3}$", "fraction": "10$^{-3}$"}  # thousandths


@dataclass(frozen=True, eq=False)
class ScoredVolume:
    """A volume beside the truth of a scan, as it is scored, drawn and written.

    Parameters
    ----------
    dataset : the scan, open
    found : the volume and the truth of what it holds
    """

    dataset: Dataset
    found: StatedVolume

    @property
    def outcome(self) -> VolumeOutcome:
        """The volume as a finished reconstruction, which predicts the test views; for basis volumes only."""
        model, stated = self.found.model, self.dataset.spectra.basis
        chosen = named_basis(stated, model.basis_names, self.dataset.path)
        dataset = self.dataset.with_basis(chosen)
        transmission = read_measurements(dataset, dataset.splits["train"][:1]).transmission
        missing = left_out(stated.names, chosen.names)
        return VolumeOutcome(dataset, model, transmission, self.about, self.settings, left_out=missing)

    @property
    def settings(self) -> dict[str, Any]:
        """Content of ``recipe.yaml``."""
        return {"method": "volume"} | self.found.record

    @property
    def about(self) -> dict[str, Any]:
        """First entries of ``metrics.json``."""
        return {"dataset": self.dataset.path.name, "method": self.settings}

    def scores(self, guard: Guard) -> dict[str, Any]:
        """Compute what ``metrics.json`` holds beside times and memory.

        Parameters
        ----------
        guard : of each score; what it catches is left out

        Returns
        -------
        entries of ``metrics.json``
        """
        quantities, model = self.found.quantities, self.found.model
        remarks = {"remarks": self.found.remarks()}
        if self.found.complete:
            truth = read_truth(self.dataset.path)
            return self.outcome.scores(truth, guard) | remarks
        scores = score_truth(quantities.truth, model)
        parts = zip(scores["basis"].values(), quantities.energies, quantities.water, strict=True)
        for row, energy, water in parts:
            if energy is not None:
                row["energy_keV"] = energy
            if water is not None:
                row |= {f"{name}_hu": 1000 * row[name] / water for name in ("bias", "rmse")}
        named = {quantities.group: scores["basis"], "materials": scores["materials"]}
        return self.about | named | remarks | {"versions": environment()}

    def write(self, folder: Path) -> None:
        """Write the volume on the grid of the dataset, and what was stated about it.

        Parameters
        ----------
        folder : run folder
        """
        if self.found.complete:
            self.outcome.write(folder)
            return
        grid, names = self.dataset.grid, self.found.model.basis_names
        write_volumes(folder / VOLUMES, self.found.model.volume(grid), names, grid, {}, unit=self.found.quantities.unit)
        (folder / "recipe.yaml").write_text(yaml.safe_dump(self.settings, sort_keys=False), encoding="utf-8")

    def draw(self, folder: Path, guard: Guard) -> None:
        """Draw all figures.

        Parameters
        ----------
        folder : of the figures
        guard : of each figure; what it catches is left out
        """
        if self.found.complete:
            self.outcome.draw(read_truth(self.dataset.path), folder, guard)
            return
        group = self.found.quantities.group
        unit = {"unit": _DRAWN_IN[group]} if group in _DRAWN_IN else {}
        draw_volumes(self.dataset, self.found.quantities.truth, self.found.model, folder, guard=guard, **unit)


@without_other_pools()
def score_volume(
    sources: Sequence[str | np.ndarray],
    dataset: Dataset,
    stated: Statement,
    folder: RunFolder | None,
    figures: bool,
    on_stage: Callable[[str], None],
    warn: Callable[[str, Exception], None],
) -> dict[str, Any]:
    """Score volumes against the truth of a dataset.

    Parameters
    ----------
    sources : files, run folders or arrays
    dataset : open dataset with a truth
    stated : what the user states about the volumes
    folder : to write; None for no files
    figures : whether to draw
    on_stage : called with the name when a stage begins
    warn : called when a score or a figure fails, with a sentence and the error

    Returns
    -------
    what ``metrics.json`` holds

    Notes
    -----
    Nothing is written before the volumes are read and checked.
    """
    clock = Stopwatch(on_stage)
    with clock("read"):
        found = stated_volume(sources, stated, dataset, read_truth(dataset.path))
    scored = ScoredVolume(dataset, found)
    if folder is None:
        with clock("score"):
            metrics = scored.scores(unguarded)
        return metrics | {"seconds": clock.seconds, "peak_memory_mib": peak_memory_mib()}
    guard = WarnOnFailure(warn)
    with folder as part:
        with clock("write"):
            scored.write(part)
        with clock("score"):
            metrics = scored.scores(guard)
        if figures:
            with clock("figures"):
                scored.draw(part / "figures", guard)
        metrics |= {"seconds": clock.seconds, "peak_memory_mib": peak_memory_mib()}
        metrics |= {"failed": guard.failed} if guard.failed else {}
        write_json(part / "metrics.json", metrics)
    return metrics
