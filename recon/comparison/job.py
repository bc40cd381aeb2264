"""What one process of a comparison is asked to do, and the files that it leaves."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from recon.runs.checkpoint import write_whole


@dataclass(frozen=True)
class Job:
    """One contender and the budgets that lack a result.

    Parameters
    ----------
    dataset : the file
    folder : of the contender; results go there, `result_file` says under which name
    contender : its word
    budgets : [s]
    clock : ``wall`` or ``cpu``
    threads : None for all
    pseudo : volumes of the channels from all views (.npy); None where there are none
    """

    dataset: str
    folder: str
    contender: str
    budgets: tuple[float, ...]
    clock: str
    threads: int | None
    pseudo: str | None

    def to_json(self) -> str:
        """For the standard input of a process."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Job":
        """What `to_json` made."""
        content = json.loads(text)
        return cls(**content | {"budgets": tuple(content["budgets"])})


def result_file(folder: Path, budget: float) -> Path:
    """Where the result of a budget is."""
    return folder / f"{budget:g}s.json"


def write_result(folder: Path, budget: float, content: dict[str, Any]) -> None:
    """Write a result so that it is whole when it is there."""
    text = json.dumps(content, indent=1, allow_nan=False) + "\n"
    write_whole(result_file(folder, budget), text.encode())


def read_result(folder: Path, budget: float) -> dict[str, Any] | None:
    """A result; None where there is none."""
    path = result_file(folder, budget)
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None
