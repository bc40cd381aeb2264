"""Bodies in a scene file: a torso or a head that stands for many objects. Lengths in mm, angles in degrees."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat

from phantomgen.scene.schema.base import Model, NonNegative, Vector
from phantomgen.scene.schema.common import ObjectModel

# Bodies of these ranges have all organs where they belong; others are refused.
BodySize = Annotated[float, Field(ge=0.6, le=1.3)]
Fat = Annotated[float, Field(ge=1, le=60)]
Part = Annotated[float, Field(ge=0, le=1)]


class ContrastModel(Model):
    """A contrast agent in blood and organs: an element in mg/ml, at the peak in arteries, and the phase of the scan."""

    phase: Literal["arterial", "portal", "late"] = "portal"
    element: str = "I"
    peak: Annotated[float, Field(gt=0, le=50)] = 12.0


class LesionModel(Model):
    """A ball in an organ: its diameter, its material, and how far it is from its usual place [mm]."""

    organ: str
    diameter: PositiveFloat = 12.0
    material: str | None = None
    offset: Vector = (0.0, 0.0, 0.0)


class StentModel(Model):
    """A tube of struts in a vessel: its material, how long it is, and how thick its struts are [mm]."""

    vessel: str
    material: str = "Fe"
    length: PositiveFloat = 18.0
    strut: PositiveFloat = 0.4


class CalcificationModel(Model):
    """A plaque in the wall of a vessel: its diameter [mm]."""

    vessel: str
    diameter: PositiveFloat = 4.0


class BodyModel(ObjectModel):
    """What all bodies have: sex, size, fat under the skin, and what may be added.

    The size is relative to a reference adult. A body has no material of its own; centre and rotation, about x, then y,
    then z, are those of a group.
    """

    sex: Literal["female", "male"] = "male"
    size: BodySize = 1.0
    fat: Fat = 15.0
    rotation: Vector = (0.0, 0.0, 0.0)
    contrast: ContrastModel | None = None
    lesion: LesionModel | None = None
    stent: StentModel | None = None
    calcification: CalcificationModel | None = None


class TorsoModel(BodyModel):
    """A torso from the shoulders to the kidneys. x points to its left, y to its back, z to its head."""

    type: Literal["torso"]
    arms: Literal["up", "down"] = "up"
    inflation: Part = 1.0
    respiration: str | None = None
    heartbeat: str | None = None


class HeadModel(BodyModel):
    """A head with its neck. x points to its left, y to its back, z to its top."""

    type: Literal["head"]
    fat: Fat = 4.0
    mouth: Annotated[NonNegative, Field(le=25)] = 0.0
    crowns: Literal["none", "gold", "titanium", "amalgam"] = "none"
