"""What documents state, where each number comes from, and whether it still holds: the model behind `numbers.yaml`."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).parents[1]
NUMBERS = ROOT / "benchmarks" / "numbers.yaml"
USUAL = {"psnr": "0.1", "psnr_zero": "0.05", "ssim": "0.002", "chi_square_away": "0.02", "chi_square_all": "5%"}
_PLACES = ("columns", "machine")
_NUMBER = re.compile(r"(?<![\w.^])-?\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.]*\w)")


@dataclass(frozen=True)
class Run:
    """Commands that give numbers.

    Parameters
    ----------
    name : what claims call it
    commands : shell words, run in a scratch folder in this order
    after : runs that come first, such as scans
    file : where its numbers are, in the scratch folder, or in `benchmarks/results`; else what it prints
    kept : file of the repository that holds the same from an earlier run, read where this one is not run
    slow : takes more than some minutes
    """

    name: str
    commands: tuple[str, ...]
    after: tuple[str, ...] = ()
    file: str = ""
    kept: str = ""
    slow: bool = False

    @property
    def within(self) -> bool:
        """Whether it writes into the repository."""
        return self.file.startswith("benchmarks/results/")

    @property
    def earlier(self) -> str:
        """Where results of an earlier run are; empty where nowhere."""
        return self.kept or (self.file if self.within else "")


@dataclass(frozen=True)
class Value:
    """One number of a sentence.

    Parameters
    ----------
    stated : as the document has it
    run : what gives it
    at : path in a JSON file, keys parted by slashes; several paths add up
    find : regular expression with one group, in place of a path
    line, number, below : else the line of a text that starts so, which number behind that, and what must come before
    spread : else beginnings that several lines share; the largest difference of their second to fourth numbers
    divide : by what is found, for another unit
    within : largest difference, absolute or in %; half of the last digit stated for what is stored
    machine : depends on the machine, so that it is printed and not judged
    """

    stated: str
    run: str
    at: tuple[str, ...] = ()
    find: str = ""
    line: str = ""
    number: int = 0
    below: str = ""
    spread: tuple[str, ...] = ()
    divide: float = 1.0
    within: str = ""
    machine: bool = False

    def measured(self, text: str) -> float:
        """The number in what the run wrote.

        Raises
        ------
        LookupError
            When it is not there.
        """
        if self.at:
            return sum(_at(json.loads(text), path) for path in self.at) / self.divide
        if self.find:
            match = re.search(self.find, text, re.MULTILINE)
            if match is None:
                raise LookupError(f"nothing matches {self.find!r}")
            return float(match.group(1)) / self.divide
        if self.spread:
            return max(_spread(text, start) for start in self.spread) / self.divide
        return numbers_of_line(text, self.line, self.below)[self.number] / self.divide

    def holds(self, measured: float) -> bool:
        """Whether what is stated is what was measured."""
        within = self.within or USUAL.get(self.at[0].rpartition("/")[2] if self.at else "", "")
        stated = float(self.stated)
        if not within:
            return abs(measured - stated) <= 0.5001 * last_digit(self.stated)
        allowed = abs(stated) * float(within[:-1]) / 100 if within.endswith("%") else float(within)
        return abs(measured - stated) <= allowed + 0.5001 * last_digit(self.stated)


@dataclass(frozen=True)
class Claim:
    """A sentence, or a row of a table, that states numbers.

    Parameters
    ----------
    document : relative to the repository
    words : as they stand there, in one line or across line breaks
    values : numbers in them that commands give
    defined : numbers in them that are no measurement
    """

    document: str
    words: str
    values: tuple[Value, ...]
    defined: tuple[str, ...] = ()

    def stands(self, text: str) -> bool:
        """Whether a document has these words."""
        return " ".join(self.words.split()) in " ".join(text.split())

    @property
    def unstated(self) -> list[str]:
        """Numbers of the values that the words do not have."""
        return [v.stated for v in self.values if v.stated not in numbers_of(self.words)]

    @property
    def uncovered(self) -> list[str]:
        """Numbers of the words that neither a value nor a definition accounts for."""
        left = numbers_of(self.words)
        for known in (*(v.stated for v in self.values), *self.defined):
            if known in left:
                left.remove(known)
        return left


@dataclass(frozen=True)
class Table:
    """A table of a document that is one of results, row by row.

    Parameters
    ----------
    document, under : where the table is: the first one behind a line that has these words
    run : what writes the results
    below : line of the results that must come before the rows
    columns : which numbers of a row of results the table shows; the first ones where none are given
    labels : first cells of rows that have another name in the results
    before : what the results have before the first cell
    machine : which of the numbers shown depend on the machine
    """

    document: str
    under: str
    run: str
    below: str = ""
    columns: tuple[int, ...] = ()
    labels: dict[str, str] = field(default_factory=dict)
    before: str = ""
    machine: tuple[int, ...] = ()

    def claims(self, text: str) -> Iterator[Claim]:
        """A claim for every row."""
        for row in table_rows(text, self.under):
            label, *cells = (plain(cell) for cell in row.strip().strip("|").split("|"))
            stated = [number for cell in cells for number in numbers_of(cell)]
            columns = self.columns or tuple(range(len(stated)))
            line = f"{self.before} {self.labels.get(label, label)}".strip()
            values = (
                Value(n, self.run, line=line, number=i, below=self.below, machine=place in self.machine)
                for place, (n, i) in enumerate(zip(stated, columns, strict=False))
            )
            yield Claim(self.document, row, tuple(values), tuple(numbers_of(label)))


@dataclass(frozen=True)
class Same:
    """Lines of a document between two fences that are lines of results, letter by letter."""

    document: str
    under: str
    run: str

    def missing(self, text: str, results: str) -> list[str]:
        """Lines that the results do not have."""
        block = text[text.index(self.under) :].split("```")[1].splitlines()[1:]
        known = {line.rstrip() for line in results.splitlines()}
        return [line for line in block if line.rstrip() not in known]


@dataclass(frozen=True)
class NumbersFile:
    """All of `numbers.yaml`."""

    runs: dict[str, Run]
    claims: tuple[Claim, ...]
    tables: tuple[Table, ...]
    same: tuple[Same, ...]

    def all_claims(self) -> list[Claim]:
        """Claims that stand by themselves, and rows of tables."""
        rows = [claim for table in self.tables for claim in table.claims(read(table.document))]
        return [*self.claims, *rows]


def read_numbers_file(path: Path = NUMBERS) -> NumbersFile:
    """Read the file; every scalar stays the text that it is, so that digits are kept."""
    entries = yaml.load(path.read_text(encoding="utf-8"), Loader=yaml.BaseLoader)
    runs = {name: _run(name, entry) for name, entry in entries["runs"].items()}
    claims = tuple(
        Claim(document, c["words"], tuple(map(_value, c["values"])), tuple(c.get("defined", ())))
        for document, found in entries["claims"].items()
        for c in found
    )
    tables = tuple(
        Table(**{**t, **{key: tuple(map(int, t.get(key, ()))) for key in _PLACES}}) for t in entries["tables"]
    )
    return NumbersFile(runs, claims, tables, tuple(Same(**s) for s in entries["same"]))


def _run(name: str, entry: dict[str, Any]) -> Run:
    commands = entry["command"]
    commands = (commands,) if isinstance(commands, str) else tuple(commands)
    file, kept = entry.get("file", ""), entry.get("kept", "")
    return Run(name, commands, tuple(entry.get("after", ())), file, kept, entry.get("slow") == "true")


def _value(entry: dict[str, Any]) -> Value:
    convert: dict[str, Callable[[Any], Any]] = {
        "at": lambda at: (at,) if isinstance(at, str) else tuple(at),
        "number": int,
        "spread": tuple,
        "divide": float,
        "machine": "true".__eq__,
    }
    given = {("stated" if key == "is" else key): convert.get(key, str)(value) for key, value in entry.items()}
    return Value(**given)


def read(document: str) -> str:
    """Text of a document of the repository."""
    return (ROOT / document).read_text(encoding="utf-8")


def plain(text: str) -> str:
    """Text of Markdown without what makes it bold, code or a link."""
    return re.sub(r"\]\([^)]*\)", "]", text).replace("*", "").replace("`", "").strip().strip("[]").strip()


def numbers_of(text: str) -> list[str]:
    """Numbers in a text, as they are written; those in code are names."""
    return _NUMBER.findall(plain(re.sub(r"`[^`]*`", " ", text)))


def last_digit(stated: str) -> float:
    """Weight of the last digit that is written."""
    mantissa, _, power = stated.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return 10.0 ** (int(power or 0) - decimals)


def numbers_of_line(text: str, start: str, below: str = "") -> list[float]:
    """Numbers behind the words that a line of results starts with, and that no other word follows.

    Raises
    ------
    LookupError
        When there is no such line.
    """
    text = text[text.index(below) :] if below and below in text else text
    if below and below not in text:
        raise LookupError(f"no line has {below!r}")
    for line in text.splitlines():
        bare = " ".join(line.replace("|", " ").split())
        rest = bare.removeprefix(" ".join(start.replace("|", " ").split()))
        if rest != bare and re.match(r"\s*[-\d]", rest):
            return [float(found) for found in _NUMBER.findall(rest.replace("/", " "))]
    raise LookupError(f"no line starts with {start!r}")


def _spread(text: str, start: str) -> float:
    """Largest difference among the second to fourth numbers of lines that start with some words."""
    bare = [" ".join(line.split()) for line in text.splitlines()]
    rows = [_NUMBER.findall(line.removeprefix(start))[1:4] for line in bare if line.startswith(start)]
    if not rows:
        raise LookupError(f"no line starts with {start!r}")
    columns = zip(*(map(float, row) for row in rows), strict=True)
    return max(max(column) - min(column) for column in columns)


def table_rows(text: str, under: str) -> list[str]:
    """Rows, without header and rule, of the first table behind some words."""
    if under not in text:
        raise LookupError(f"no words {under!r}")
    rows: list[str] = []
    for line in text[text.index(under) :].splitlines()[1:]:
        if line.startswith("|"):
            rows.append(line)
        elif rows:
            break
    return rows[2:]


def _at(tree: Any, path: str) -> float:
    for key in path.split("/"):
        if not isinstance(tree, dict) or key not in tree:
            raise LookupError(f"no key {path}")
        tree = tree[key]
    return float(tree)
