"""What all models of a scene file share: immutable, no unknown keys."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Size = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
NonNegative = Annotated[FiniteFloat, Field(ge=0)]
NonNegativeInt = Annotated[int, Field(ge=0)]
Composition = str | dict[str, FiniteFloat]


class Model(BaseModel):
    """Common settings: immutable, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)
