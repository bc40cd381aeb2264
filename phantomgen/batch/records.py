"""Records of the items of a batch: one line of JSON each, in ``manifest.jsonl`` beside the datasets."""

import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

from phantomgen.runtime.disk import one_sentence
from spectra.errors import InputError

DONE, FAILED = "done", "failed"


@dataclass(frozen=True)
class Record:
    """Record of one item.

    Parameters
    ----------
    id : number of the item
    seed : of its scene
    path : of its dataset, relative to the folder of the batch
    sha256 : of the dataset; empty where there is none
    status : ``done`` or ``failed``
    message : why it failed, in one sentence
    seconds : wall time
    recipe : digest of what the batch is made of
    """

    id: int
    seed: int
    path: str
    sha256: str
    status: str
    message: str
    seconds: float
    recipe: str


@dataclass(frozen=True)
class Shard:
    """Part of a batch that a run makes: every `count`-th item, beginning with item `index` - 1.

    Parameters
    ----------
    index, count : such as 1 and 4 for the first of four parts
    """

    index: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Parse ``"1/4"``, counted from 1.

        Parameters
        ----------
        text : the part

        Returns
        -------
        the part

        Raises
        ------
        InputError
            When the text is not of this form.
        """
        first, slash, second = text.partition("/")
        if not (slash and first.isdigit() and second.isdigit() and 1 <= int(first) <= int(second)):
            raise InputError(f"--shard is written i/n with 1 <= i <= n, such as 1/4, got {text!r}")
        return cls(int(first), int(second))

    @property
    def records(self) -> str:
        """Name of the file of records; parts that run at the same time have one each."""
        return "manifest.jsonl" if self.count == 1 else f"manifest.{self.index}of{self.count}.jsonl"

    def numbers(self, count: int) -> range:
        """Return the items of this part.

        Parameters
        ----------
        count : number of items of the batch

        Returns
        -------
        numbers of items
        """
        return range(self.index - 1, count, self.count)


def read_records(folder: Path) -> dict[int, Record]:
    """Read the last record of each item, over all parts of a batch; an incomplete line is ignored.

    Parameters
    ----------
    folder : folder of the batch

    Returns
    -------
    records by number of the item
    """
    found: dict[int, Record] = {}
    for path in sorted(folder.glob("manifest*.jsonl"), key=lambda path: path.stat().st_mtime):
        for line in path.read_text(encoding="utf-8").splitlines():
            try:
                record = Record(**json.loads(line))
            except (ValueError, TypeError):
                continue
            found[record.id] = record
    return found


def append_record(path: Path, record: Record) -> None:
    """Append a line in one write.

    Parameters
    ----------
    path : file of records
    record : the record
    """
    with one_sentence(path), path.open("a+b") as file:
        file.seek(0, os.SEEK_END)
        if file.tell():
            file.seek(-1, os.SEEK_END)
            if file.read(1) != b"\n":  # a line that was cut off
                file.write(b"\n")
        file.write(_line(record))


def rewrite_records(path: Path, records: list[Record]) -> None:
    """Write one line per item in order, or leave the file unchanged.

    Parameters
    ----------
    path : file of records
    records : one for each item
    """
    part = path.with_name(path.name + ".part")
    with one_sentence(path):
        part.write_bytes(b"".join(_line(record) for record in sorted(records, key=lambda record: record.id)))
        os.replace(part, path)


def _line(record: Record) -> bytes:
    """One record as JSON."""
    return json.dumps(asdict(record)).encode() + b"\n"
