"""The scene file as models: what may stand in it, checked key by key.

Lengths in mm, energies in keV, angles in degrees. Every model refuses keys it does not know. `scene_yaml` gives the
errors a file, a line and a column; `scene` turns the models into physics.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, PositiveFloat, PositiveInt

Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Size = tuple[PositiveFloat, PositiveFloat, PositiveFloat]
NonNegativeInt = Annotated[int, Field(ge=0)]
Composition = str | dict[str, FiniteFloat]


class Model(BaseModel):
    """Common settings: immutable, no unknown keys."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class FilterModel(Model):
    """A flat filter: formula or mass fractions, density [g/cm^3] where it is not known, thickness [mm]."""

    composition: Composition
    density: PositiveFloat | None = None
    thickness: Annotated[FiniteFloat, Field(ge=0)]


class BowtieModel(Model):
    """A bowtie filter: thickness [mm] along rays in the plane of the orbit, linear between fan angles [degree].

    Angles grow with the columns of the panel; angles from 0 on stand for both sides.
    """

    composition: Composition
    density: PositiveFloat | None = None
    angles: Annotated[tuple[FiniteFloat, ...], Field(min_length=2)]
    thickness: tuple[Annotated[FiniteFloat, Field(ge=0)], ...]


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
    """A spectrum from a text file of two columns, energy [keV] and photons; see docs/spectra.md.

    Without `photons` in all, the values are photons per pixel and view. A relative path starts at the folder of the
    scene file.
    """

    type: Literal["table"]
    file: str
    values: Literal["per_bin", "per_kev"]
    energies: Literal["centres", "edges"]
    filters: tuple[FilterModel, ...] = ()
    bowtie: BowtieModel | None = None
    photons: PositiveFloat | None = None


OneSourceModel = Annotated[
    TubeModel | MonochromaticModel | LinesModel | BandModel | TableModel, Field(discriminator="type")
]


class SeveralSourcesModel(Model):
    """Named sources: `multi_source` takes every view with each of them, with `switching` views take turns."""

    type: Literal["multi_source", "switching"]
    sources: Annotated[
        dict[Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]*$")], OneSourceModel], Field(min_length=2)
    ]


class ChargeSharingModel(Model):
    """Pixels of the sensor itself: pitch, and the standard deviation of a charge cloud [mm]."""

    pitch: PositiveFloat
    cloud: Annotated[FiniteFloat, Field(ge=0)]


class DeadTimeModel(Model):
    """Counts lost because a pixel is busy: dead time [ns], exposure of one view [ms], and the kind of counter."""

    tau_ns: PositiveFloat
    exposure_ms: PositiveFloat
    model: Literal["nonparalyzable", "paralyzable"] = "nonparalyzable"


class PhotonCountingModel(Model):
    """A photon-counting detector; a channel reaches from its threshold to the next.

    It is ideal unless it has a resolution (full width at half maximum [keV]), fluorescence or shared charge.
    """

    type: Literal["photon_counting"]
    thresholds: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    composition: Composition = "CdTe"
    density: PositiveFloat | None = None
    thickness: PositiveFloat = 1.6
    resolution: Annotated[FiniteFloat, Field(ge=0)] = 0.0
    fluorescence: bool = False
    charge_sharing: ChargeSharingModel | None = None
    dead_time: DeadTimeModel | None = None


class AxisModel(Model):
    """Evenly spaced energies [keV]."""

    first: Annotated[FiniteFloat, Field(ge=0)]
    step: PositiveFloat


class ResponseMatrixModel(Model):
    """Counters by a table of counts per incident photon: a CSV or .npy file, or a dataset such as file.h5:/path.

    Rows are energies of incident photons, columns channels or bins of deposited energy. A CSV file has the energies in
    its first column, and names of channels, or the middles of bins, in its first line; for arrays `energies` and
    `deposited` give both. Deposited energies are counted `per` bin or keV. Relative paths start at the folder of the
    scene file.
    """

    type: Literal["response_matrix"]
    file: str
    columns: Literal["channels", "deposited"]
    thresholds: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    energies: AxisModel | None = None
    deposited: AxisModel | None = None
    per: Literal["bin", "keV"] | None = None
    dead_time: DeadTimeModel | None = None


class EnergyIntegratingModel(Model):
    """A scintillator that sums up the energies of the photons it absorbs, in one channel [keV].

    The composition is CsI, GOS, GOS screen or CdWO4, with nominal density and thickness where these are left out; or
    any other with density [g/cm^3] and thickness [mm].
    """

    type: Literal["energy_integrating"]
    composition: Composition = "CsI"
    density: PositiveFloat | None = None
    thickness: PositiveFloat | None = None


class CircularModel(Model):
    """Circular orbit: training views at i 360/views degrees, test views at (j + 1/2) 360/test_views degrees."""

    type: Literal["circular"]
    sod: PositiveFloat
    sdd: PositiveFloat
    views: PositiveInt
    test_views: NonNegativeInt = 0


class PanelModel(Model):
    """The pixel grid; one pitch [mm] for square pixels, else (between rows, between columns).

    Pixels average over their area, split along silhouettes; `sub_rays` takes a plain grid of so many rays along each
    edge of a pixel instead, faster and less exact, and 1 takes the ray through the centre alone.
    """

    rows: PositiveInt
    columns: PositiveInt
    pitch: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    sub_rays: Annotated[int, Field(ge=1, le=16)] | None = None


class VolumeModel(Model):
    """The cube that truth is given on and that is asked for: voxels along each edge, edge length [mm]."""

    voxels: PositiveInt
    size: PositiveFloat


class PlainFunctionModel(Model):
    """A basis function without an edge."""

    type: Literal["photoelectric", "compton"]


class EdgeFunctionModel(Model):
    """A K-edge function at an energy, or at the K edge of an element; the width is that of the logistic function."""

    type: Literal["step", "sigmoid"]
    edge: PositiveFloat | None = None
    element: str | None = None
    width: Annotated[FiniteFloat, Field(ge=0)] = 0.0


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


class MixtureModel(Model):
    """Parts by fractions of mass or volume that sum to 1; a part is a material of the scene, a name or a formula."""

    by: Literal["mass", "volume"]
    parts: Annotated[dict[str, Annotated[FiniteFloat, Field(ge=0, le=1)]], Field(min_length=1)]


class SolutionModel(Model):
    """Solutes by mass per volume of the solution [mg/ml]; the solvent fills the volume that they leave."""

    solvent: str
    solutes: Annotated[dict[str, Annotated[FiniteFloat, Field(ge=0)]], Field(min_length=1)]


class MaterialModel(Model):
    """One of: composition (formula, name or mass fractions), mixture, solution, or basis coefficients [1/mm].

    The density [g/cm^3] is needed for formulas and mass fractions; that of mixtures and solutions follows from their
    parts where it is left out. Coefficients may be negative where objects add up.
    """

    composition: Composition | None = None
    density: PositiveFloat | None = None
    coefficients: dict[str, FiniteFloat] | None = None
    mixture: MixtureModel | None = None
    solution: SolutionModel | None = None


class PlaneModel(Model):
    """A plane that cuts off what lies beyond it: normal . x >= offset [mm]; the normal may have any length."""

    normal: Vector
    offset: FiniteFloat = 0.0


class GridModel(Model):
    """Copies on a grid around the original: how many along x, y and z, and how far apart [mm]."""

    type: Literal["grid"]
    count: tuple[PositiveInt, PositiveInt, PositiveInt]
    step: Vector


class RingModel(Model):
    """Copies turned about the z axis, evenly over a full turn."""

    type: Literal["ring"]
    count: PositiveInt


RepeatModel = Annotated[GridModel | RingModel, Field(discriminator="type")]


class ObjectModel(Model):
    """Common keys: the name of a material, the centre (x, y, z) [mm], planes that cut, and a pattern of copies.

    Objects and members of groups need a material; shapes that others are combined from have none.
    """

    material: str | None = None
    center: Vector = (0.0, 0.0, 0.0)
    clip: tuple[PlaneModel, ...] = ()
    repeat: RepeatModel | None = None


class SphereModel(ObjectModel):
    """A ball."""

    type: Literal["sphere"]
    radius: PositiveFloat


class EllipsoidModel(ObjectModel):
    """Half axes [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["ellipsoid"]
    radii: Size
    rotation: Vector = (0.0, 0.0, 0.0)


class CylinderModel(ObjectModel):
    """A capped cylinder along any axis; one radius, or two for an elliptic one."""

    type: Literal["cylinder"]
    radius: PositiveFloat | tuple[PositiveFloat, PositiveFloat]
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class BoxModel(ObjectModel):
    """Full edge lengths [mm] along x, y, z, turned about x, then y, then z [degree]."""

    type: Literal["box"]
    size: Size
    rotation: Vector = (0.0, 0.0, 0.0)


class TubeShapeModel(ObjectModel):
    """A circular cylinder with a coaxial bore."""

    type: Literal["tube"]
    radius: PositiveFloat
    inner_radius: PositiveFloat
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class CapsuleModel(ObjectModel):
    """A circular cylinder with half balls on its ends; the length is that of the straight part."""

    type: Literal["capsule"]
    radius: PositiveFloat
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class ConeModel(ObjectModel):
    """A cone, or a frustum: radii at the beginning and at the end of the axis, one of which may be 0."""

    type: Literal["cone"]
    radii: tuple[Annotated[FiniteFloat, Field(ge=0)], Annotated[FiniteFloat, Field(ge=0)]]
    length: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class TorusModel(ObjectModel):
    """A ring: radius to the middle of the tube, radius of the tube, normal of its plane."""

    type: Literal["torus"]
    radius: PositiveFloat
    tube: PositiveFloat
    axis: Vector = (0.0, 0.0, 1.0)


class PolygonModel(ObjectModel):
    """A simple polygon with corners (x, y) [mm], drawn out along z, turned about x, then y, then z [degree]."""

    type: Literal["polygon"]
    points: Annotated[tuple[tuple[FiniteFloat, FiniteFloat], ...], Field(min_length=3)]
    length: PositiveFloat
    rotation: Vector = (0.0, 0.0, 0.0)


class MeshModel(ObjectModel):
    """A closed mesh: STL, OBJ, PLY, GLB, 3MF or STEP file, scaled, turned (about x, then y, then z; degrees) and moved.

    A relative path starts at the folder of the scene file.
    """

    type: Literal["mesh"]
    file: str
    unit: Literal["mm", "cm", "m", "um", "inch"]
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0


class SweepModel(ObjectModel):
    """A round tube along a smooth curve: points that it passes, one radius [mm] or one per point.

    It is a mesh, with so many corners around and so many rings from point to point.
    """

    type: Literal["sweep"]
    points: Annotated[tuple[Vector, ...], Field(min_length=2)]
    radius: PositiveFloat | tuple[PositiveFloat, ...]
    sides: Annotated[int, Field(ge=3)] = 24
    steps: PositiveInt = 8


class VoxelsModel(ObjectModel):
    """A box of voxels from a file: labels, volume fractions, or Hounsfield units, and the materials they stand for.

    Spacing [mm] along x, y and z, and the centre, are the file's own unless given; turned about x, then y, then z
    [degree]. Voxels without material are background. A relative path starts at the folder of the scene file.
    """

    type: Literal["voxels"]
    file: str | None = None
    labels: dict[int, str | None] | None = None
    fractions: dict[str, str] | tuple[str, ...] | None = None
    hu: Literal["default"] | Annotated[dict[str, tuple[FiniteFloat, FiniteFloat]], Field(min_length=1)] | None = None
    spacing: PositiveFloat | Size | None = None
    center: Vector | None = None  # type: ignore[assignment]
    rotation: Vector = (0.0, 0.0, 0.0)


class CombinedModel(ObjectModel):
    """What lies in any (`union`) or in all (`intersection`) of some shapes."""

    type: Literal["union", "intersection"]
    shapes: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]


class DifferenceModel(ObjectModel):
    """What lies in a shape and in none of those that are cut off."""

    type: Literal["difference"]
    base: "ShapeModel"
    cut: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]


class GroupModel(ObjectModel):
    """Objects that are scaled, then turned about x, then y, then z [degree], then moved to the centre, together."""

    type: Literal["group"]
    objects: Annotated[tuple["ShapeModel", ...], Field(min_length=1)]
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: PositiveFloat | Size = 1.0


SourceModel = Annotated[OneSourceModel | SeveralSourcesModel, Field(discriminator="type")]
DetectorModel = Annotated[
    PhotonCountingModel | EnergyIntegratingModel | ResponseMatrixModel, Field(discriminator="type")
]
FunctionModel = Annotated[
    PlainFunctionModel | EdgeFunctionModel | ElementFunctionModel | MaterialFunctionModel | SvdFunctionsModel,
    Field(discriminator="type"),
]
ShapeModel = Annotated[
    SphereModel
    | EllipsoidModel
    | CylinderModel
    | BoxModel
    | TubeShapeModel
    | CapsuleModel
    | ConeModel
    | TorusModel
    | PolygonModel
    | MeshModel
    | SweepModel
    | VoxelsModel
    | CombinedModel
    | DifferenceModel
    | GroupModel,
    Field(discriminator="type"),
]


class SceneModel(Model):
    """One scene file: what is scanned, with what, and how the truth is wanted.

    Later objects override earlier ones where they overlap; with `overlap: add` their coefficients add up. What none of
    them fills, from source to panel, is vacuum or the material `background`. Basis functions left out are chosen from
    the materials; a K-edge function that no object needs is left out of the dataset.
    """

    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    source: SourceModel
    detector: DetectorModel
    geometry: CircularModel
    panel: PanelModel
    volume: VolumeModel
    basis: tuple[FunctionModel, ...] | None = None
    materials: dict[str, MaterialModel]
    objects: Annotated[tuple[ShapeModel, ...], Field(min_length=1)]
    overlap: Literal["replace", "add"] = "replace"
    background: str | None = None
    seed: NonNegativeInt = 0
    noise: bool = True
    flats: PositiveInt = 50
    darks: NonNegativeInt = 1


def json_schema() -> dict[str, Any]:
    """JSON Schema of a scene file, for completion in editors."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneModel.model_json_schema()}
