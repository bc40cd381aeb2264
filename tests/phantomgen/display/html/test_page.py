"""The frame of pages: figures fit into them, nothing is loaded from elsewhere, and outputs are checked first."""

import base64
import re

import numpy as np
import pytest

from phantomgen.display.figures.style import figure_file, write_csv
from phantomgen.display.html import Code, Page, Paragraph, Section, Table, check_page, picture, render, write_page
from phantomgen.display.html.svg import adapted
from spectra.errors import InputError


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    path = tmp_path_factory.mktemp("figures") / "curve.svg"
    write_csv(path, {"x": np.arange(3.0), "y": np.array([1.0, 4.0, 9.0])})
    with figure_file(path, (2.0, 1.5)) as figure:
        ax = figure.subplots()
        ax.plot([0, 1, 2], [1, 4, 9], color="black", marker="o")
        ax.plot([0, 1], [1, 2], color="0.6")
        ax.imshow(np.eye(3), cmap="gray")
    return path


def page_of(*parts):
    return Page("A <b>", "about", (("1", "one"),), (Section("First part", parts),), "end", (("this", "why."),))


def test_a_figure_is_written_the_same_twice(drawn):
    before = drawn.read_bytes()
    assert b"<svg" in before
    assert b"date" not in before.lower().split(b"<defs>")[0]


def test_black_and_gray_follow_the_text_and_other_colours_stay(drawn):
    svg = adapted(drawn.read_text(encoding="utf-8"), "a-")
    assert svg.startswith("<svg")
    assert "#000000" not in svg
    assert "color-mix(in srgb, currentColor 40%, transparent)" in svg
    assert 'width="100%" fill="currentColor"' in svg
    assert adapted('<svg width="1pt" height="1pt"><g style="fill: #d55e00"/></svg>', "").count("#d55e00") == 1


def test_two_figures_share_no_ids_and_refer_to_their_own(drawn):
    text = render(page_of(picture(drawn, "one"), picture(drawn, "two")))
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    used = re.findall(r'url\(#([^)]+)\)|href="#([^"]+)"', text)
    assert {a or b for a, b in used} <= set(ids)


def test_numbers_of_figures_and_tables_are_in_the_page(drawn):
    table = Table(("name", "value"), (("a, b", "1"),), "caption", "numbers")
    text = render(page_of(picture(drawn, "one"), table))
    links = dict(re.findall(r'download="([^"]+)" href="data:text/csv;base64,([^"]+)"', text))
    assert base64.b64decode(links["curve.csv"]).decode() == drawn.with_suffix(".csv").read_text(encoding="utf-8")
    assert base64.b64decode(links["numbers.csv"]).decode() == 'name,value\n"a, b",1\n'


def test_a_page_loads_nothing_and_takes_words_as_words(drawn):
    text = render(page_of(picture(drawn, "one"), Paragraph("x < y & <script>"), Code("code", "<i>")))
    assert "<script" not in text
    assert "A &lt;b&gt;" in text
    outside = re.findall(r'(?:src|href)="(?!data:|#)([^"]+)"', text)
    assert outside == []
    assert "@import" not in text


@pytest.mark.parametrize(
    ("name", "words"),
    [("report.pdf", "ends in .html"), ("no/report.html", "does not exist"), ("there.html", "add --overwrite")],
)
def test_outputs_are_refused_before_work(name, words, tmp_path):
    (tmp_path / "there.html").write_text("old")
    with pytest.raises(InputError, match=words):
        check_page(tmp_path / name, overwrite=False)


def test_a_page_appears_whole(drawn, tmp_path):
    size = write_page(page_of(picture(drawn, "one")), tmp_path / "p.html")
    assert [path.name for path in tmp_path.iterdir()] == ["p.html"]
    assert (tmp_path / "p.html").stat().st_size == size
