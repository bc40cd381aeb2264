"""Basis functions in a scene file. Energies in keV."""

from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from phantomgen.scene.schema.base import Model, NonNegative


class PlainFunctionModel(Model):
    """A basis function without an edge."""

    type: Literal["photoelectric", "compton"]


class EdgeFunctionModel(Model):
    """A K-edge function at an energy, or at the K edge of an element; the width is that of the logistic function.

    Files may call `edge_energy` `edge`, as earlier versions did.
    """

    type: Literal["step", "sigmoid"]
    edge_energy: PositiveFloat | None = None
    element: str | None = None
    width: NonNegative = 0.0

    @model_validator(mode="before")
    @classmethod
    def _with_present_name(cls, values: Any) -> Any:
        if not isinstance(values, dict) or "edge" not in values:
            return values
        if "edge_energy" in values:
            raise ValueError("edge is the earlier name of edge_energy: give one of them")
        return {"edge_energy" if key == "edge" else key: value for key, value in values.items()}


class ElementFunctionModel(Model):
    """The attenuation curve of one element."""

    type: Literal["element"]
    element: str


class MaterialFunctionModel(Model):
    """The attenuation curve of a material: one of the scene, a named one or a formula."""

    type: Literal["material"]
    material: str


class SvdFunctionsModel(Model):
    """So many singular vectors of the curves of some materials, over the detected spectrum."""

    type: Literal["svd"]
    materials: Annotated[tuple[str, ...], Field(min_length=1)]
    count: PositiveInt


FunctionModel = Annotated[
    PlainFunctionModel | EdgeFunctionModel | ElementFunctionModel | MaterialFunctionModel | SvdFunctionsModel,
    Field(discriminator="type"),
]
