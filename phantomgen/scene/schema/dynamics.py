"""Time in a scene file: signals, and what follows them. Times in s, lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt

from phantomgen.scene.schema.base import Model, NonNegative, Size, Vector

Share = Annotated[PositiveFloat, Field(le=1)]
Deviation = Annotated[NonNegative, Field(le=0.5)]


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


class ObjectMotionModel(Model):
    """Motion of an object: shift [mm], rotation [degree] and scale that it has where the signal is 1.

    They are proportional to the signal; an object turns about x, then y, then z, and scales, around its `pivot` [mm],
    which is its centre where left out. A `path` [mm] are further shifts, at equal steps of the signal from 0 to 1,
    joined by a smooth curve.
    """

    signal: str
    shift: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0
    path: Annotated[tuple[Vector, ...], Field(min_length=2)] | None = None
    pivot: Vector | None = None


class InflowModel(Model):
    """A material that changes: `rest` where the signal is 0, `peak` where it is 1, a mixture by volume between."""

    rest: str
    peak: str
    signal: str
