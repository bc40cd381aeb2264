"""Folder of a comparison: missing results are computed, by a process for each contender; a failure ends only that one.

The folder holds ``settings.json``, ``results/<contender>/<budget>s.json`` and what `recon.comparison.tables.table` and
`recon.comparison.tables.figure` make of them.
"""

import hashlib
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.runtime.outputs import check_output_folder
from recon.comparison.contenders.contender import Contender
from recon.comparison.contenders.other_program import OtherProgram
from recon.comparison.job import Job, read_result, result_file, write_result
from recon.data.measurements import matching_bin, read_measurements
from recon.voxel.filtered.fdk import Fdk
from recon.voxel.image_domain import log_projections
from spectra.errors import Error, InputError
from spectra.threads import set_threads, without_other_pools

SETTINGS, RESULTS, PSEUDO = "settings.json", "results", "pseudo-truth.npy"
_SAMPLE = 2**20  # bytes; part at either end of a file that its fingerprint depends on

Tell = Callable[[str], None]
Result = dict[str, Any]


@dataclass(frozen=True)
class Settings:
    """Settings that all results of a folder have in common.

    Parameters
    ----------
    dataset : name of the file
    fingerprint : of its content, see `fingerprint`
    clock : ``wall`` or ``cpu``
    threads : number for each method; None for all
    """

    dataset: str
    fingerprint: str
    clock: str
    threads: int | None


class Campaign:
    """Folder of a comparison.

    Parameters
    ----------
    dataset : the file
    folder : to write in
    clock, threads : see `Settings`
    resume : compute missing results in a folder that exists
    overwrite : replace a folder that exists
    stated : quantities that volumes of other programs hold, at whose energies all results are scored

    Raises
    ------
    InputError
        When the folder exists and neither is given, when it is no comparison, or one with other settings.
    """

    def __init__(
        self,
        dataset: Path,
        folder: Path,
        clock: str,
        threads: int | None,
        resume: bool,
        overwrite: bool,
        stated: tuple[str, ...] = (),
    ) -> None:
        with open_dataset(dataset) as opened:
            opened.splits  # noqa: B018 - a damaged file is refused now
        self.dataset, self.folder, self.stated = dataset, folder, stated
        self.settings = Settings(dataset.name, fingerprint(dataset), clock, threads)
        check_output_folder(folder, overwrite or resume, "recon compare", _is_comparison, "run what is missing")
        if folder.exists() and overwrite:
            shutil.rmtree(folder)
        if folder.exists():
            self._check_settings()
        (folder / RESULTS).mkdir(parents=True, exist_ok=True)
        (folder / SETTINGS).write_text(json.dumps(asdict(self.settings), indent=1) + "\n", encoding="utf-8")

    def run(
        self, who: Sequence[Contender | OtherProgram], budgets: Sequence[float], tell: Tell = lambda sentence: None
    ) -> None:
        """Compute missing results; failed ones are repeated, but not those for which a budget was too short.

        Parameters
        ----------
        who : contenders, and other programs; finished volumes are scored anew
        budgets : times that each contender gets [s]
        tell : gets the progress, one sentence at a time
        """
        for contender in who:
            place = self.folder / RESULTS / str(contender)
            if isinstance(contender, OtherProgram) and contender.path is not None:
                tell(f"{contender}: {contender.path}")
                self._work(contender, place, ())
                continue
            missing = tuple(b for b in budgets if not self._is_known(contender, read_result(place, b)))
            if not missing:
                tell(f"{contender}: done before")
                continue
            tell(f"{contender}: {', '.join(f'{b:g} s' for b in missing)} ...")
            self._work(contender, place, missing)
            for budget in missing:
                tell(_outcome(read_result(place, budget) or {}))

    def results(self, who: Sequence[Contender | OtherProgram], budgets: Sequence[float]) -> list[Result]:
        """Read the results in the order of contenders and budgets.

        Parameters
        ----------
        who : contenders
        budgets : [s]

        Returns
        -------
        those that exist
        """
        each = [(one, _budgets_of(one, budgets)) for one in who]
        pairs = ((self.folder / RESULTS / str(one), budget) for one, own in each for budget in own)
        found = (read_result(place, budget) for place, budget in pairs)
        return [result for result in found if result is not None]

    def _is_known(self, contender: Contender | OtherProgram, result: Result | None) -> bool:
        """Whether a repetition would give the same."""
        if result is None or not ("seconds" in result or result.get("too_short")):
            return False
        if isinstance(contender, OtherProgram):
            return result.get("command") == list(contender.command)
        return "seconds" not in result or set(self.stated) <= set(result.get("stated_as", ()))

    def _work(self, contender: Contender | OtherProgram, place: Path, budgets: tuple[float, ...]) -> None:
        """Run a process that writes results; where it ends without one, the last line of its messages is the result."""
        place.mkdir(parents=True, exist_ok=True)
        own = _budgets_of(contender, budgets)
        for budget in own:
            result_file(place, budget).unlink(missing_ok=True)
        pseudo = self._pseudo_truth()
        job = Job(
            str(self.dataset), str(place), str(contender), budgets, self.settings.clock, self.settings.threads,
            None if pseudo is None else str(pseudo), self.stated,
            contender if isinstance(contender, OtherProgram) else None,
        )  # fmt: skip
        command = [sys.executable, "-m", "recon.comparison.worker"]
        ended = subprocess.run(command, input=job.to_json(), capture_output=True, text=True, check=False)
        (place / "log.txt").write_text(ended.stdout + ended.stderr, encoding="utf-8")
        for budget in own:
            if read_result(place, budget) is None:
                last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
                error = f"the process ended with status {ended.returncode}: {last}"
                write_result(place, budget, {"contender": str(contender), "budget": budget, "error": error})
        shutil.rmtree(place / "models", ignore_errors=True)

    def _pseudo_truth(self) -> Path | None:
        """File of `pseudo_truth`, which is computed once; None where there is none."""
        path = self.folder / PSEUDO
        if not path.is_file():
            set_threads(self.settings.threads)
            with open_dataset(self.dataset) as opened:
                volumes = pseudo_truth(opened)
            if volumes is None:
                return None
            np.save(path, volumes)
        return path.absolute()

    def _check_settings(self) -> None:
        other = json.loads((self.folder / SETTINGS).read_text(encoding="utf-8"))
        changed = [name for name, value in asdict(self.settings).items() if other.get(name) != value]
        if changed:
            raise InputError(
                f"{self.folder} was begun with another {' and '.join(changed)}: ask for the same, or add --overwrite"
            )


def _is_comparison(folder: Path) -> bool:
    """Whether a folder was written by a comparison."""
    return (folder / SETTINGS).is_file()


def _budgets_of(contender: Contender | OtherProgram, budgets: Sequence[float]) -> Sequence[float | None]:
    """Budgets of a contender; None for a finished volume, which has one result."""
    finished = isinstance(contender, OtherProgram) and contender.path is not None
    return (None,) if finished else budgets


@without_other_pools()
def pseudo_truth(dataset: Dataset) -> np.ndarray | None:
    """Reconstruct each channel by filtered back-projection of its log projections, from training and test views.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    attenuation [1/mm], (channel, z, y, x); None where the orbit does not allow filtered back-projection
    """
    views = np.arange(len(dataset.geometry))
    try:
        measured = read_measurements(dataset, views, 1)
        coarse = measured.completed().binned(matching_bin(measured.geometry, min(dataset.grid.spacing)))
        return Fdk("hann").reconstruct(log_projections(coarse), None, coarse.geometry, dataset.grid)
    except Error:
        return None


def fingerprint(path: Path) -> str:
    """Compute a number that differs between files of different size, beginning or end.

    Parameters
    ----------
    path : the file

    Returns
    -------
    SHA-256 of size, first and last megabyte, as hexadecimal digits
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        digest = hashlib.sha256(str(size).encode() + file.read(_SAMPLE))
        file.seek(max(size - _SAMPLE, 0))
        digest.update(file.read(_SAMPLE))
    return digest.hexdigest()


def _outcome(result: Result) -> str:
    if "error" in result:
        return f"  {result['budget']:g} s: {result['error']}"
    end = "finished" if result["finished"] else "stopped"
    return f"  {result['budget']:g} s: {end} at {result['seconds']:.1f} s, {result['done']} of {result['total']}"
