"""What a page consists of."""

import io
from collections.abc import Sequence
from csv import writer
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar


@dataclass(frozen=True)
class Picture:
    """A figure.

    Parameters
    ----------
    svg : as matplotlib writes it, on no background
    caption : what it shows, a sentence or two
    name : of the file that its numbers are saved as, without suffix
    csv : its numbers; empty where there are none
    wide : whether it takes the whole width of a page; others stand side by side
    """

    kind: ClassVar[str] = "picture"
    svg: str
    caption: str
    name: str
    csv: str = ""
    wide: bool = False


@dataclass(frozen=True)
class Table:
    """Numbers in rows.

    Parameters
    ----------
    header : of the columns
    rows : cells as text; the first one of a row names it
    caption : what it shows
    name : of the file that it is saved as, without suffix
    csv : the same with all digits; what is shown where left out
    """

    kind: ClassVar[str] = "table"
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str
    name: str
    csv: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "csv", self.csv or csv_of(self.header, self.rows))


@dataclass(frozen=True)
class Words:
    """A paragraph."""

    kind: ClassVar[str] = "words"
    text: str


@dataclass(frozen=True)
class Code:
    """A long text that is folded away under a heading."""

    kind: ClassVar[str] = "code"
    heading: str
    text: str


Part = Picture | Table | Words | Code


@dataclass(frozen=True)
class Section:
    """A chapter of a page.

    Parameters
    ----------
    title : of the chapter
    parts : in their order
    """

    title: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Page:
    """A whole page.

    Parameters
    ----------
    title : large, on top
    subtitle : what it is about, below
    facts : a few numbers that matter most, as (number, what it is)
    sections : in their order
    footer : where it comes from
    """

    title: str
    subtitle: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    footer: str = ""
    left_out: tuple[tuple[str, str], ...] = field(default=())


def picture(path: Path, caption: str, csv: str = "", wide: bool = False) -> Picture:
    """A figure that was written as SVG, with its numbers: those given, or those in the CSV beside it."""
    numbers = path.with_suffix(".csv")
    text = csv or (numbers.read_text(encoding="utf-8") if numbers.is_file() else "")
    return Picture(path.read_text(encoding="utf-8"), caption, path.stem, text, wide)


def csv_of(header: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Rows as text with commas."""
    out = io.StringIO()
    writer(out, lineterminator="\n").writerows([header, *rows])
    return out.getvalue()
