"""What options of a look say."""

from phantomgen.display.viewer.content import Triple
from spectra.errors import InputError


def point_of(text: str) -> Triple:
    """``"x,y,z"`` as three numbers."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"a point is written x,y,z in mm, such as 0,-12.5,3, got {text!r}") from None
    return x, y, z


def size_of(text: str) -> tuple[int, int]:
    """``"1600x1000"`` as two numbers of pixels."""
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(f"a size is written WIDTHxHEIGHT in pixels, such as 1600x1000, got {text!r}") from None
    if not (200 <= width <= 8000 and 200 <= height <= 8000):
        raise InputError(f"a picture is 200 to 8000 pixels wide and high, got {text}")
    return width, height
