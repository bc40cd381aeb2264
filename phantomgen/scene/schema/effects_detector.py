"""Effects of the detector in a scene file. Lengths in mm, signals in keV."""

from typing import Annotated

from pydantic import Field, PositiveFloat

from phantomgen.scene.schema.base import Model, NonNegative, NonNegativeInt

_Small = Annotated[NonNegative, Field(le=0.2)]
_Half = Annotated[NonNegative, Field(le=0.5)]
_Part = Annotated[NonNegative, Field(le=0.9)]


class BlurModel(Model):
    """A Gaussian point spread: its MTF at one frequency [1/mm], or its full width at half maximum [mm]."""

    mtf: Annotated[PositiveFloat, Field(lt=1)] | None = None
    frequency: PositiveFloat | None = None
    fwhm: Annotated[PositiveFloat, Field(le=1000)] | None = None


class GainModel(Model):
    """Sensitivity that differs between pixels: relative standard deviations; `in_flats`, or in views only."""

    sigma: _Small = 0.0
    columns: _Small = 0.0
    smooth: _Small = 0.0
    drift: _Small = 0.0
    in_flats: bool = True


class LagModel(Model):
    """Afterglow: parts of a signal that are stored, and the time constant [view] with which each is released."""

    fractions: Annotated[tuple[_Part, ...], Field(min_length=1)]
    decays: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]


class ElectronicsModel(Model):
    """Noise of readings, a standard deviation, and their offset [keV]; of detectors that integrate energy."""

    sigma: NonNegative
    offset: NonNegative = 0.0


class DefectsModel(Model):
    """Pixels that do not measure: parts that are dead or stuck at a level, dead discs and lines; `masked`, or not.

    The level is relative to the open beam; lines are indices, counted from 0; the radius of clusters is in pixels.
    """

    dead: _Half = 0.0
    hot: _Half = 0.0
    level: NonNegative = 2.0
    clusters: NonNegativeInt = 0
    radius: NonNegative = 2.0
    rows: tuple[NonNegativeInt, ...] = ()
    columns: tuple[NonNegativeInt, ...] = ()
    masked: bool = True
