"""Options of the viewer as values."""

from phantomgen.display.viewer.content import Triple
from spectra.errors import InputError


def point_of(text: str) -> Triple:
    """Parse ``"x,y,z"`` to three numbers.

    Parameters
    ----------
    text : the point

    Returns
    -------
    (x, y, z) [mm]

    Raises
    ------
    InputError
        When the text is not of this form.
    """
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"a point is written x,y,z in mm, such as 0,-12.5,3, got {text!r}") from None
    return x, y, z


def size_of(text: str) -> tuple[int, int]:
    """Parse ``"1600x1000"`` to two numbers of pixels.

    Parameters
    ----------
    text : the size

    Returns
    -------
    width and height [pixel]

    Raises
    ------
    InputError
        When the text is not of this form.
    """
    try:
        width, height = (int(part) for part in text.lower().split("x"))
    except ValueError:
        raise InputError(f"a size is written WIDTHxHEIGHT in pixels, such as 1600x1000, got {text!r}") from None
    if not (200 <= width <= 8000 and 200 <= height <= 8000):
        raise InputError(f"a picture is 200 to 8000 pixels wide and high, got {text}")
    return width, height
