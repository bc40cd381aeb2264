"""Input of one process of a comparison, and the files that it writes."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recon.comparison.contenders.other_program import OtherProgram
from recon.runs.checkpoint import write_whole


@dataclass(frozen=True)
class Job:
    """One contender and the budgets that lack a result.

    Parameters
    ----------
    dataset : the file
    folder : of the contender, where results are written, see `result_file`
    contender : its word, see `recon.comparison.contenders.contender`
    budgets : [s]; none for a finished volume
    clock : ``wall`` or ``cpu``
    threads : number of threads; None for all
    pseudo : file of `recon.comparison.campaign.pseudo_truth` (.npy); None where there is none
    stated : quantities that volumes of other programs hold, at whose energies attenuation is scored
    program : other program, in place of a method of ours
    """

    dataset: str
    folder: str
    contender: str
    budgets: tuple[float, ...]
    clock: str
    threads: int | None
    pseudo: str | None
    stated: tuple[str, ...] = ()
    program: OtherProgram | None = None

    def to_json(self) -> str:
        """Convert to the JSON that a process reads from its standard input.

        Returns
        -------
        the JSON
        """
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Job":
        """Read what `to_json` gave.

        Parameters
        ----------
        text : the JSON

        Returns
        -------
        the job
        """
        content = json.loads(text)
        program = content["program"]
        if program is not None:
            program = OtherProgram(**program | {"command": tuple(program["command"])})
        tuples = {name: tuple(content[name]) for name in ("budgets", "stated")}
        return cls(**content | tuples | {"program": program})


def result_file(folder: Path, budget: float | None) -> Path:
    """Return the file of the result for a budget.

    Parameters
    ----------
    folder : of the contender
    budget : [s]; None for a finished volume

    Returns
    -------
    its name
    """
    return folder / ("finished.json" if budget is None else f"{budget:g}s.json")


def write_result(folder: Path, budget: float | None, content: dict[str, Any]) -> None:
    """Write a result, which is complete when its file appears.

    Parameters
    ----------
    folder : of the contender
    budget : [s]; None for a finished volume
    content : the result, without NaN
    """
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_whole(result_file(folder, budget), text.encode())


def read_result(folder: Path, budget: float | None) -> dict[str, Any] | None:
    """Read a result.

    Parameters
    ----------
    folder : of the contender
    budget : [s]; None for a finished volume

    Returns
    -------
    the result; None where there is none
    """
    path = result_file(folder, budget)
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
