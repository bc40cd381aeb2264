"""Parts of a page: figures, tables, text."""

import io
from collections.abc import Sequence
from csv import writer
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar


@dataclass(frozen=True)
class Picture:
    """Figure of a page.

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
    """Table of a page.

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
class Paragraph:
    """Paragraph of a page.

    Parameters
    ----------
    text : the paragraph
    """

    kind: ClassVar[str] = "words"
    text: str


@dataclass(frozen=True)
class Code:
    """Long text that is folded below a heading.

    Parameters
    ----------
    heading : the heading
    text : the text
    """

    kind: ClassVar[str] = "code"
    heading: str
    text: str


Part = Picture | Table | Paragraph | Code


@dataclass(frozen=True)
class Section:
    """Chapter of a page.

    Parameters
    ----------
    title : of the chapter
    parts : in their order
    """

    title: str
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class Page:
    """Whole page.

    Parameters
    ----------
    title : large, on top
    subtitle : subject of the page, below the title
    facts : the most important numbers, as (number, its meaning)
    sections : in their order
    footer : origin of the page
    left_out : names of parts that could not be made, and why
    """

    title: str
    subtitle: str
    facts: tuple[tuple[str, str], ...]
    sections: tuple[Section, ...]
    footer: str = ""
    left_out: tuple[tuple[str, str], ...] = field(default=())


def picture(path: Path, caption: str, csv: str = "", wide: bool = False) -> Picture:
    """Create a figure from an SVG file, with its numbers: those given, or those in the CSV beside it.

    Parameters
    ----------
    path : the SVG file
    caption : what the figure shows
    csv : its numbers; those of the CSV file where left out
    wide : whether it takes the whole width of the page

    Returns
    -------
    the figure
    """
    numbers = path.with_suffix(".csv")
    text = csv or (numbers.read_text(encoding="utf-8") if numbers.is_file() else "")
    return Picture(path.read_text(encoding="utf-8"), caption, path.stem, text, wide)


def csv_of(header: Sequence[object], rows: Sequence[Sequence[object]]) -> str:
    """Write rows as comma-separated text.

    Parameters
    ----------
    header : of the columns
    rows : cells

    Returns
    -------
    the text
    """
    out = io.StringIO()
    writer(out, lineterminator="\n").writerows([header, *rows])
    return out.getvalue()
