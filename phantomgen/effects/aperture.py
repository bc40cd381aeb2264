"""Pixels that are sensitive in their central part only.

Model: photons count where they meet the rectangle of `width` x `height` parts of a pixel around its centre, and are
lost elsewhere. So the counts of every frame, flats too, are those of the whole pixel times the area of that part,
averaged over it alone: sharper than whole pixels, by sinc(width f) in place of sinc(f) at f cycles per pixel.
"""

from dataclasses import dataclass

from spectra.errors import InputError


@dataclass(frozen=True)
class Aperture:
    """Sensitive part of a pixel.

    Parameters
    ----------
    width, height : parts of the step to the next column and of that to the next row, above 0 and at most 1

    Raises
    ------
    InputError
        When a part is not within these limits.
    """

    width: float
    height: float

    def __post_init__(self) -> None:
        for name, part in (("width", self.width), ("height", self.height)):
            if not 0 < part <= 1:
                raise InputError(f"the {name} of an aperture must lie above 0 and be at most 1 pixel, got {part:g}")

    @property
    def area(self) -> float:
        """Part of the photons that are not lost."""
        return self.width * self.height
