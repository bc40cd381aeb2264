"""Materials in a scene file. Densities in g/cm^3, coefficients in 1/mm."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat

from phantomgen.scene.schema.base import Composition, Model, NonNegative
from phantomgen.scene.schema.dynamics import InflowModel


class MixtureModel(Model):
    """Parts by fractions of mass or volume that sum to 1; a part is a material of the scene, a name or a formula."""

    by: Literal["mass", "volume"]
    parts: Annotated[dict[str, Annotated[FiniteFloat, Field(ge=0, le=1)]], Field(min_length=1)]


class SolutionModel(Model):
    """Solutes by mass per volume of the solution [mg/ml]; the solvent fills the volume that they leave."""

    solvent: str
    solutes: Annotated[dict[str, NonNegative], Field(min_length=1)]


class MaterialModel(Model):
    """One of: composition (formula, name or mass fractions), mixture, solution, basis coefficients [1/mm], or inflow.

    The density [g/cm^3] is needed for formulas and mass fractions; that of mixtures and solutions follows from their
    parts where it is left out. Coefficients may be negative where objects add up.
    """

    composition: Composition | None = None
    density: PositiveFloat | None = None
    coefficients: dict[str, FiniteFloat] | None = None
    mixture: MixtureModel | None = None
    solution: SolutionModel | None = None
    inflow: InflowModel | None = None
