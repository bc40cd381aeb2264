"""Motion of the sample between views in a scene file: `shift` [mm] and `rotation` [degree] along and about x, y, z."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat

from phantomgen.scene.schema.base import Model, NonNegative, Vector

Deviations = tuple[NonNegative, NonNegative, NonNegative]


class DriftModel(Model):
    """Uniform motion that reaches shift and rotation at the end of the scan."""

    type: Literal["drift"]
    shift: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)


class SinusoidModel(Model):
    """Sine of so many `periods` in the scan, with a `phase` [degree] at time 0; shift and rotation at its crest."""

    type: Literal["sinusoid"]
    shift: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)
    periods: NonNegative = 1.0
    phase: FiniteFloat = 0.0


class RandomWalkModel(Model):
    """Normal steps from view to view, with these standard deviations."""

    type: Literal["random_walk"]
    shift: Deviations = (0.0, 0.0, 0.0)
    rotation: Deviations = (0.0, 0.0, 0.0)


MotionModel = Annotated[DriftModel | SinusoidModel | RandomWalkModel, Field(discriminator="type")]
