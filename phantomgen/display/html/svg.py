"""Figures that are part of a page: SVG in the page's own colours, whether light, dark or on paper."""

import re

_ID = re.compile(r'(\bid="|url\(#|href="#)')
_GRAY = re.compile(r"#([0-9a-f]{2})\1\1\b")
_SIZE = re.compile(r'width="([0-9.]+)pt" height="[0-9.]+pt"')


def adapted(svg: str, prefix: str) -> str:
    """Adapt an SVG of matplotlib for a page with other figures.

    Parameters
    ----------
    svg : the whole file
    prefix : goes before its ids, so that no two figures share one

    Returns
    -------
    The ``svg`` element. Black is the page's text colour, grays are mixtures of it with the background, and it is as
    wide as its place allows.
    """
    body = svg[svg.index("<svg") :]
    body = re.sub(r"<metadata>.*?</metadata>\s*", "", body, flags=re.DOTALL)
    body = re.sub(r"<!--.*?-->\s*", "", body, flags=re.DOTALL)
    body = _ID.sub(lambda found: found[1] + prefix, body)
    body = _GRAY.sub(_ink, body)
    return _SIZE.sub('width="100%" fill="currentColor"', body, count=1)


def natural_width(svg: str) -> float:
    """Return the width that a figure was drawn for.

    Parameters
    ----------
    svg : the SVG

    Returns
    -------
    width [pt]
    """
    found = _SIZE.search(svg)
    return float(found[1]) if found else 0.0


def _ink(found: "re.Match[str]") -> str:
    """A gray as so much of the text colour; white stays, as it lies on pictures."""
    level = int(found[1], 16) / 255
    if level == 0:
        return "currentColor"
    return found[0] if level == 1 else f"color-mix(in srgb, currentColor {100 * (1 - level):.0f}%, transparent)"
