"""Anti-scatter grid in front of the panel.

A grid of lamellae absorbs a part of the primary photons and most of the scattered ones. Its transmissions are measured
as IEC 60627 describes; they follow from its ratio, its lamellae and the beam, and are stated here as two numbers, equal
for all pixels and energies. Flats have the grid as well.
"""

from dataclasses import dataclass

from spectra.errors import InputError


@dataclass(frozen=True)
class AntiScatterGrid:
    """Parts of the photons that pass a grid.

    Parameters
    ----------
    primary : part of the primary photons, above 0 and at most 1
    scatter : part of the scattered photons, from 0 to 1

    Raises
    ------
    InputError
        When a part is not within these limits.
    """

    primary: float
    scatter: float

    def __post_init__(self) -> None:
        if not 0 < self.primary <= 1:
            raise InputError(
                f"the part of primary photons that pass a grid must lie above 0 and be at most 1, got {self.primary:g}"
            )
        if not 0 <= self.scatter <= 1:
            raise InputError(
                f"the part of scattered photons that pass a grid must lie from 0 to 1, got {self.scatter:g}"
            )
