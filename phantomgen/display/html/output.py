"""Output of pages."""

import os
from pathlib import Path

from phantomgen.display.html.content import Page
from phantomgen.display.html.render import render
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError


def check_page(path: Path, overwrite: bool) -> None:
    """Refuse a page that cannot be written, before any work.

    Parameters
    ----------
    path : the page
    overwrite : whether an existing file may be replaced

    Raises
    ------
    InputError
        When the name does not end in .html, the file exists and `overwrite` is not given, or its folder does not exist.
    """
    if path.suffix.lower() not in {".html", ".htm"}:
        raise InputError(f"a report ends in .html, got {path.name!r}")
    check_output(path, overwrite, example="report.html")


def write_page(page: Page, path: Path) -> int:
    """Write a page beside its name, then rename it.

    Parameters
    ----------
    page : the page
    path : its file

    Returns
    -------
    size [byte]

    Raises
    ------
    InputError
        When the page cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(render(page), encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    return path.stat().st_size
