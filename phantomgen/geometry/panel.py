"""The pixel grid of a flat detector."""

from dataclasses import dataclass

from spectra.errors import InputError


@dataclass(frozen=True)
class Panel:
    """A flat panel of `rows` x `columns` pixels.

    Parameters
    ----------
    rows, columns : number of pixels along each axis
    pitch : distance between pixel centres (along rows, along columns) [mm]; one number for square pixels
    """

    rows: int
    columns: int
    pitch: tuple[float, float] | float

    def __post_init__(self) -> None:
        if not isinstance(self.pitch, tuple):
            object.__setattr__(self, "pitch", (float(self.pitch), float(self.pitch)))
        if self.rows < 1 or self.columns < 1:
            raise InputError(f"a panel needs at least one row and one column, got {self.rows} x {self.columns}")
        if min(self.row_pitch, self.column_pitch) <= 0:
            raise InputError(f"the pixel pitch must be positive, got {self.pitch} mm")

    @property
    def row_pitch(self) -> float:
        """Distance between neighbouring rows [mm]."""
        return self.pitch[0]  # type: ignore[index]

    @property
    def column_pitch(self) -> float:
        """Distance between neighbouring columns [mm]."""
        return self.pitch[1]  # type: ignore[index]
