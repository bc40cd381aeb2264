"""What is to be made worse in a scan."""

from dataclasses import dataclass
from math import isfinite
from typing import Literal, get_args

from spectra.errors import InputError

Flats = Literal["keep", "thin"]


@dataclass(frozen=True)
class Degradation:
    """What is to be made worse in a scan; the defaults change nothing.

    Parameters
    ----------
    dose : part of the dose that is left, above 0, at most 1
    complement : write the counts that `dose` would leave out, in place of those that it keeps
    flats : ``keep`` the open-beam frames as measured, or ``thin`` them like the views
    noise : draw Poisson counts from a scan that was made without noise
    views : number of training views that are left, evenly spread; all where None
    arc : first and last angle that training views may have [degree], from the first training view on; all where None
    truncate : part of the columns that is cut off, half of it on each side
    bin : pixels along each side that are summed into one
    dead : part of the pixels that are dead afterwards, in addition to those that are
    dead_columns : number of columns that are dead from end to end afterwards
    hot : part of the pixels that read twice the open beam afterwards, in views, flats and darks; they are not marked
    saturate : largest reading of a pixel in the views, in open beams; 0 for no limit
    drift : part of the tube output that is lost from the first to the last view of the scan; the file does not state it
    shift : how far the stated panel lies from the true one along its columns [pixel of the result]
    tilt : how far the stated panel is turned in its plane from the true one, from columns towards rows [degree]
    kv_error : stated tube voltage less the true one [kV]
    seed : of photons, and of dead and hot pixels

    Raises
    ------
    InputError
        When a number is out of its range.
    """

    dose: float = 1.0
    complement: bool = False
    flats: Flats = "keep"
    noise: bool = False
    views: int | None = None
    arc: tuple[float, float] | None = None
    truncate: float = 0.0
    bin: int = 1
    dead: float = 0.0
    dead_columns: int = 0
    hot: float = 0.0
    saturate: float = 0.0
    drift: float = 0.0
    shift: float = 0.0
    tilt: float = 0.0
    kv_error: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        if not 0 < self.dose <= 1:
            raise InputError(
                f"a dose must lie above 0 and be at most 1, got {self.dose:g}: photons that were never "
                "counted cannot be added"
            )
        if self.complement and self.dose == 1:
            raise InputError("the complement of dose 1 holds no photon: choose a dose below 1")
        if self.flats not in get_args(Flats):
            raise InputError(f"flats must be one of {', '.join(get_args(Flats))}, got {self.flats!r}")
        if self.views is not None and self.views < 1:
            raise InputError(f"at least one training view must be left, got views {self.views}")
        if self.arc is not None and not (0 <= self.arc[0] < self.arc[1] and isfinite(self.arc[1])):
            raise InputError(
                f"an arc needs two angles that ascend from at least 0 degrees, got {self.arc[0]:g}:{self.arc[1]:g}"
            )
        for part, what in ((self.truncate, "columns to cut off"), (self.drift, "tube output that drifts away")):
            if not 0 <= part < 1:
                raise InputError(f"the part of the {what} must lie in 0 .. 1, got {part:g}")
        if self.drift and self.complement:
            raise InputError("a complement has the photons that a dose leaves out: leave out the drift")
        if self.bin < 1:
            raise InputError(f"pixels are binned by 1, 2 or more, got {self.bin}")
        for name in ("shift", "tilt", "kv_error"):
            if not isfinite(getattr(self, name)):
                raise InputError(f"{name} must be finite, got {getattr(self, name)}")
        if not 0 <= self.seed < 2**64:
            raise InputError(f"a seed must lie in 0 .. 2^64 - 1, got {self.seed}")

    @property
    def written_dose(self) -> float:
        """Part of the dose that the written scan has."""
        return 1 - self.dose if self.complement else self.dose
