"""HTML pages with figures, tables and text in one file that requires no other file."""

from phantomgen.display.html.content import Code, Page, Paragraph, Part, Picture, Section, Table, picture
from phantomgen.display.html.output import check_page, write_page
from phantomgen.display.html.render import render

__all__ = [
    "Code",
    "Page",
    "Paragraph",
    "Part",
    "Picture",
    "Section",
    "Table",
    "check_page",
    "picture",
    "render",
    "write_page",
]
