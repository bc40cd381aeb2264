"""Time in a scene file: signals, and what follows them. Times in s, lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt, model_validator

from phantomgen.scene.schema.base import Model, NonNegative, Size, Vector

Share = Annotated[PositiveFloat, Field(le=1)]
Deviation = Annotated[NonNegative, Field(le=0.5)]
MOST_POINTS = 64  # along each axis of a lattice
LatticeRow = Annotated[tuple[Vector, ...], Field(min_length=1, max_length=MOST_POINTS)]
LatticeLayer = Annotated[tuple[LatticeRow, ...], Field(min_length=1, max_length=MOST_POINTS)]


class SineSignalModel(Model):
    """From 0 to 1 and back, as (1 - cos) / 2 of one turn per `period` [s]; `start` is the part of it at time 0."""

    type: Literal["sine"]
    period: PositiveFloat
    start: FiniteFloat = 0.0


class RespiratorySignalModel(Model):
    """Breathing after Lujan: 0 at the end of exhaling, where it stays the longest, 1 at the end of inhaling.

    The value is cos^(2 `exponent`) of half a turn per `period` [s]. `period_deviation` and `amplitude_deviation` are
    relative standard deviations from breath to breath, drawn by the seed of the scene.
    """

    type: Literal["respiratory"]
    period: PositiveFloat = 4.0
    exponent: Annotated[PositiveInt, Field(le=20)] = 3
    start: FiniteFloat = 0.0
    period_deviation: Deviation = 0.0
    amplitude_deviation: Deviation = 0.0


class CardiacSignalModel(Model):
    """Contraction of a heart: 0 to 1 within the part `systole` of a `period` [s], back to 0 within `relaxation`."""

    type: Literal["cardiac"]
    period: PositiveFloat = 1.0
    systole: Share = 0.35
    relaxation: Share = 0.3
    start: FiniteFloat = 0.0


class GammaVariateSignalModel(Model):
    """Inflow and washout of a contrast agent: 0 before `arrival` [s], 1 at `rise` [s] after it, then less again.

    The value is (x exp(1 - x))^`shape` with x = (time - arrival) / rise.
    """

    type: Literal["gamma_variate"]
    arrival: FiniteFloat
    rise: PositiveFloat
    shape: PositiveFloat = 3.0


class TableSignalModel(Model):
    """Values at times [s], linear between them and constant outside, or repeated after `period` [s]."""

    type: Literal["table"]
    times: Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
    values: Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
    period: PositiveFloat | None = None


SignalModel = Annotated[
    SineSignalModel | RespiratorySignalModel | CardiacSignalModel | GammaVariateSignalModel | TableSignalModel,
    Field(discriminator="type"),
]


class PhasesModel(Model):
    """Division of the views: into so many parts of the cycle of a `signal`, or of the time where none is named."""

    count: Annotated[int, Field(ge=2, le=100)]
    signal: str | None = None


class TimeModel(Model):
    """Time of a scan: the `duration` [s] of the training views, signals by name, and phases of truth and gating.

    Each view is one instant; with `exposure` [s] it is the mean over so long a time around it.
    """

    duration: PositiveFloat
    signals: Annotated[dict[str, SignalModel], Field(min_length=1)]
    phases: PhasesModel | None = None
    exposure: NonNegative = 0.0


class LatticeModel(Model):
    """Displacements `shifts` [mm] at the points of a lattice from `low` to `high` (x, y, z) [mm].

    They are nested lists: layers along z, of rows along y, of points along x, each with three components. Between the
    points they follow cubic splines; beyond the lattice they stay as at its faces.
    """

    low: Vector
    high: Vector
    shifts: Annotated[tuple[LatticeLayer, ...], Field(min_length=1, max_length=MOST_POINTS)]

    @model_validator(mode="after")
    def _is_a_lattice(self) -> "LatticeModel":
        if any(high <= low for low, high in zip(self.low, self.high, strict=True)):
            raise ValueError(f"high must exceed low along x, y and z, got {self.low} and {self.high}")
        rows, columns = len(self.shifts[0]), len(self.shifts[0][0])
        if any(len(layer) != rows or any(len(row) != columns for row in layer) for layer in self.shifts):
            raise ValueError("all layers of a lattice have as many rows, and all rows as many points")
        return self


class ObjectMotionModel(Model):
    """Motion of an object: shift [mm], rotation [degree] and scale that it has where the signal is 1.

    They are proportional to the signal; an object turns about x, then y, then z, and scales, around its `pivot` [mm],
    which is its centre where left out. A `path` [mm] are further shifts, at equal steps of the signal from 0 to 1,
    joined by a smooth curve. `deform` are displacements at points of a lattice, where the signal is 1; they come first.
    """

    signal: str
    shift: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0
    path: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    pivot: Vector | None = None
    deform: LatticeModel | None = None


class InflowModel(Model):
    """A material that changes: `rest` where the signal is 0, `peak` where it is 1, a mixture by volume between."""

    rest: str
    peak: str
    signal: str
