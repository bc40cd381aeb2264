"""Sources in a scene file. Energies in keV, lengths in mm."""

from typing import Annotated, Literal

from pydantic import Field, FiniteFloat, PositiveFloat

from phantomgen.scene.schema.base import Composition, Model, NonNegative


class FilterModel(Model):
    """A flat filter: formula or mass fractions, density [g/cm^3] where it is not known, thickness [mm]."""

    composition: Composition
    density: PositiveFloat | None = None
    thickness: NonNegative


class BowtieModel(Model):
    """A bowtie filter: thickness [mm] along rays in the plane of the orbit, linear between fan angles [degree].

    Angles grow with the columns of the panel; angles from 0 on stand for both sides.
    """

    composition: Composition
    density: PositiveFloat | None = None
    angles: Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
    thickness: tuple[NonNegative, ...]


class ModulationModel(Model):
    """Tube current that differs between views.

    It follows the attenuation of each view, as a topogram of the scene shows it, to the power `strength` (0.5: least
    noise), between `least` and `most` of the mean, which `photons` or `mas` state. Or `factors`, one for each view and
    training views first, multiply `photons` or `mas`.
    """

    strength: Annotated[NonNegative, Field(le=1)] | None = None
    least: PositiveFloat = 0.1
    most: PositiveFloat = 10.0
    factors: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)] | None = None


class TubeModel(Model):
    """A reflection tube; photons are incident per pixel and view at the panel centre, behind the filters.

    In their place may stand the charge per view [mAs], from which SpekPy's model gives the photons. With `heel` the
    spectrum changes along z; the anode is on the side of +z.
    """

    type: Literal["tube"]
    kvp: PositiveFloat
    anode: str = "tungsten"
    angle: PositiveFloat = 12.0
    filters: tuple[FilterModel, ...] = ()
    bowtie: BowtieModel | None = None
    photons: PositiveFloat | None = None
    mas: PositiveFloat | None = None
    heel: bool = False
    modulation: ModulationModel | None = None


class MonochromaticModel(Model):
    """All photons at one energy."""

    type: Literal["monochromatic"]
    energy: PositiveFloat
    bowtie: BowtieModel | None = None
    photons: PositiveFloat


class LinesModel(Model):
    """Several single energies: energy [keV] to weight; without `photons` in all, weights are photons."""

    type: Literal["lines"]
    lines: Annotated[dict[PositiveFloat, PositiveFloat], Field(min_length=1)]
    filters: tuple[FilterModel, ...] = ()
    bowtie: BowtieModel | None = None
    photons: PositiveFloat | None = None


class BandModel(Model):
    """A band around an energy [keV]; the width is that at half of the maximum [keV]."""

    type: Literal["band"]
    energy: PositiveFloat
    width: PositiveFloat
    shape: Literal["gaussian", "box"] = "gaussian"
    filters: tuple[FilterModel, ...] = ()
    bowtie: BowtieModel | None = None
    photons: PositiveFloat


class TableModel(Model):
    """A spectrum from a text file of two columns, energy [keV] and photons; see docs/reference/spectra.md.

    Without `photons` in all, the values are photons per pixel and view. A relative path starts at the folder of the
    scene file.
    """

    type: Literal["table"]
    file: str
    values: Literal["per_bin", "per_kev"]
    energies: Literal["centres", "edges", "corners"]
    filters: tuple[FilterModel, ...] = ()
    bowtie: BowtieModel | None = None
    photons: PositiveFloat | None = None


OneSourceModel = Annotated[
    TubeModel | MonochromaticModel | LinesModel | BandModel | TableModel, Field(discriminator="type")
]


class MultiSourceModel(Model):
    """Named sources: `multi_source` takes every view with each of them, with `switching` views take turns."""

    type: Literal["multi_source", "switching"]
    sources: Annotated[
        dict[Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")], OneSourceModel], Field(min_length=2)
    ]


SourceModel = Annotated[OneSourceModel | MultiSourceModel, Field(discriminator="type")]
