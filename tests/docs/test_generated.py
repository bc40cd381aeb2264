"""What the documentation site makes of docstrings and links; only where the packages of the site are installed."""

import sys
from pathlib import Path

import pytest

pytest.importorskip("sphinx_gallery")
sys.path.insert(0, str(Path(__file__).parents[2] / "docs"))
generated = pytest.importorskip("generated")


def test_descriptions_of_parameters_stand_below_their_names():
    lines = [
        "Fit a scan.",
        "",
        "Parameters",
        "----------",
        "name : of the scan, as a",
        "    user knows it",
        "size, pitch : in mm",
        "",
        "Returns",
        "-------",
        "volumes : of each basis",
    ]
    generated.describe_below_names(None, "function", "fit", None, None, lines)
    assert lines[4:8] == ["name", "    of the scan, as a", "    user knows it", "size, pitch"]
    assert lines[-1] == "volumes : of each basis"


def test_links_to_pages_from_elsewhere_lead_to_where_the_site_has_them():
    text = (
        "[how](../../CONTRIBUTING.md#kernels), [README](../../README.md), [here](page.md), [there](https://a.org/b.md)"
    )
    found = generated.with_links(text, "docs/development/adding.md", "docs/development/adding.md")
    assert "(../outside/contributing.md#kernels)" in found
    assert "(../outside/readme.md)" in found
    assert "(page.md)" in found
    assert "(https://a.org/b.md)" in found
