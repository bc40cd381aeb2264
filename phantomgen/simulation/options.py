"""Options of a simulation, with their defaults: accuracy, contents of the dataset, and how the run goes."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from phantomgen.dataset.compression import Compression


def _silent(_: str) -> None:
    """Say nothing about a stage."""


@dataclass(frozen=True)
class SimulationOptions:
    """Keyword arguments of `phantomgen.simulation.run.simulate`.

    Parameters
    ----------
    tolerance : worst error of log projections that is wanted, no unit; None for
        `phantomgen.simulation.planning.plan.TOLERANCE` as far as the scene allows
    overwrite : replace a file that exists
    keep_expected : store the counts without noise in the truth as well
    keep_paths : store the projections of each view at a few energies, so that `paths` of a later run may name this one
    paths : dataset with such projections of the same objects, materials and geometry: views are computed from there,
        with the spectra, doses, channels and noise of the scan
    verify : measure the error on all edge pixels of three views, not on a sample
    progress : show a progress bar on stderr
    on_stage : called with the name of each stage when it begins
    resume : go on with the frames that an interrupted run left, if any; the dataset is the same as without interruption
    compression : of the large arrays
    """

    tolerance: float | None = None
    overwrite: bool = False
    keep_expected: bool = False
    keep_paths: bool = False
    paths: Path | str | None = None
    verify: bool = False
    progress: bool = False
    on_stage: Callable[[str], None] = _silent
    resume: bool = False
    compression: Compression = "gzip"

    @property
    def stored(self) -> dict[str, str]:
        """Options that decide what frames of an interrupted run hold, under names that a message may show."""
        return {"compression": self.compression, "keep": f"{self.keep_expected}{' paths' * self.keep_paths}"}
