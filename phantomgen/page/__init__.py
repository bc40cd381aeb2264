"""Pages for people: figures, tables and words in one HTML file that needs nothing else."""

from phantomgen.page.content import Code, Page, Part, Picture, Section, Table, Words, picture
from phantomgen.page.output import check_page, write_page
from phantomgen.page.render import render

__all__ = [
    "Code",
    "Page",
    "Part",
    "Picture",
    "Section",
    "Table",
    "Words",
    "check_page",
    "picture",
    "render",
    "write_page",
]
