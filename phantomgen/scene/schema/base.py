"""Types that the models of a scene file share."""

from pydantic import FiniteFloat, PositiveFloat

from phantomgen.geometry.schema import Model, NonNegative, NonNegativeInt

__all__ = ["Composition", "Model", "NonNegative", "NonNegativeInt", "Size", "Vector"]

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Size = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
Composition = str | dict[str, FiniteFloat]
