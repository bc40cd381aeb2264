"""Effects of a real scan in a scene file; each is off where its key is left out."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat

from phantomgen.scene.schema.base import Model, NonNegative
from phantomgen.scene.schema.effects_detector import BlurModel, DefectsModel, ElectronicsModel, GainModel, LagModel
from phantomgen.scene.schema.motion import MotionModel


class TubeOutputModel(Model):
    """Output of the tube that varies between exposures: relative standard deviation; `recorded` in the file, or not."""

    sigma: Annotated[NonNegative, Field(le=0.2)]
    recorded: bool = True


class FocalSpotModel(Model):
    """Focal spot that faces the panel: width along rows of pixels, height along columns of them [mm].

    They are full sizes, for `gaussian` full widths at half maximum; a height left out is the width.
    """

    width: NonNegative
    height: NonNegative | None = None
    shape: Literal["uniform", "gaussian"] = "uniform"


Share = Annotated[PositiveFloat, Field(le=1)]


class ApertureModel(Model):
    """Sensitive part of a pixel's width and height, around its centre; photons that miss it are lost."""

    width: Share
    height: Share | None = None


class KernelScatterModel(Model):
    """Scatter as a smooth cloud around where the beam is attenuated.

    `ratio` is that of scattered to primary signal in the shadow of the objects in the first view, `width` the full
    width at half maximum of the kernel on the panel [mm].
    """

    type: Literal["kernel"]
    ratio: NonNegative
    width: PositiveFloat


class ComptonScatterModel(Model):
    """Photons that free electrons scatter once, with the Klein-Nishina cross section."""

    type: Literal["compton"]


ScatterModel = Annotated[KernelScatterModel | ComptonScatterModel, Field(discriminator="type")]


class AntiScatterGridModel(Model):
    """Anti-scatter grid: parts of primary and of scattered photons that pass it."""

    primary: Share
    scatter: Annotated[NonNegative, Field(le=1)]


class EffectsModel(Model):
    """Effects of a real scan beyond exposure and photon noise."""

    tube_output: TubeOutputModel | None = None
    focal_spot: FocalSpotModel | None = None
    aperture: ApertureModel | None = None
    scatter: ScatterModel | None = None
    grid: AntiScatterGridModel | None = None
    motion: MotionModel | None = None
    blur: BlurModel | None = None
    gain: GainModel | None = None
    lag: LagModel | None = None
    electronics: ElectronicsModel | None = None
    defects: DefectsModel | None = None
