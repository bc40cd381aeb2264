"""Conversion of a page to HTML."""

import base64
import re

from phantomgen.display.html.content import Page
from phantomgen.display.html.svg import adapted, natural_width

_LARGEST = 1.45  # a figure is shown at most so many times larger than it was drawn


def render(page: Page) -> str:
    """Convert a page to HTML that contains everything it shows.

    Parameters
    ----------
    page : the page

    Returns
    -------
    the HTML
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined  # noqa: PLC0415 - only where a page is written

    environment = Environment(
        loader=PackageLoader("phantomgen.display.html", ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(adapted=adapted, data_link=_data_link, anchor=_anchor, widest=_widest)
    return environment.get_template("page.html.j2").render(page=page)


def _data_link(text: str) -> str:
    """A table as an address that holds it whole."""
    return "data:text/csv;base64," + base64.b64encode(text.encode()).decode()


def _anchor(title: str) -> str:
    """Name of a section in addresses."""
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def _widest(svg: str) -> int:
    """Largest width to show a figure at [px]."""
    return round(natural_width(svg) * 96 / 72 * _LARGEST)
