"""Keys that all objects of a scene file have. Lengths in mm."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveInt

from phantomgen.scene.schema.base import Model, Vector
from phantomgen.scene.schema.dynamics import ObjectMotionModel

Copies = Annotated[PositiveInt, Field(le=100_000)]


class PlaneModel(Model):
    """A plane that cuts off what lies beyond it: normal . x >= offset [mm]; the normal may have any length."""

    normal: Vector
    offset: FiniteFloat = 0.0


class GridModel(Model):
    """Copies on a grid around the original: how many along x, y and z, and how far apart [mm]."""

    type: Literal["grid"]
    count: tuple[Copies, Copies, Copies]
    step: Vector


class RingModel(Model):
    """Copies turned about the z axis, evenly over a full turn."""

    type: Literal["ring"]
    count: Copies


RepeatModel = Annotated[GridModel | RingModel, Field(discriminator="type")]


class ObjectModel(Model):
    """Common keys: material, centre (x, y, z) [mm], planes that cut, a pattern of copies, and motion in time.

    Objects and members of groups need a material; shapes that others are combined from have none.
    """

    material: str | None = None
    center: Vector = (0.0, 0.0, 0.0)
    clip: tuple[PlaneModel, ...] = ()
    repeat: RepeatModel | None = None
    motion: ObjectMotionModel | None = None
