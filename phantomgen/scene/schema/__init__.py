"""The scene file as models: what may stand in it, checked key by key.

Lengths in mm, energies in keV, angles in degrees. Every model refuses keys it does not know. `scene_yaml` gives the
errors a file, a line and a column; `scene` turns the models into physics.
"""

from typing import Annotated, Any, Literal

from pydantic import Field, PositiveInt

from phantomgen.geometry.schema import (
    CircularModel,
    HelicalModel,
    JitterModel,
    LaminographyModel,
    OffsetModel,
    OrbitModel,
    PanelModel,
    ParallelModel,
    PosesModel,
    TiltModel,
)
from phantomgen.scene.schema.base import Composition, Model, NonNegativeInt, Vector
from phantomgen.scene.schema.bodies import HeadModel, TorsoModel
from phantomgen.scene.schema.common import GridModel, ObjectModel, PlaneModel, RepeatModel, RingModel
from phantomgen.scene.schema.detectors import (
    AxisModel,
    ChargeSharingModel,
    DeadTimeModel,
    DetectorModel,
    EnergyIntegratingModel,
    PhotonCountingModel,
    ResponseMatrixModel,
)
from phantomgen.scene.schema.dynamics import (
    CardiacSignalModel,
    GammaVariateSignalModel,
    InflowModel,
    LatticeModel,
    ObjectMotionModel,
    PhasesModel,
    RespiratorySignalModel,
    SignalModel,
    SineSignalModel,
    TableSignalModel,
    TimeModel,
)
from phantomgen.scene.schema.effects import (
    ApertureModel,
    ComptonScatterModel,
    EffectsModel,
    FocalSpotModel,
    KernelScatterModel,
    ScatterModel,
    TubeOutputModel,
)
from phantomgen.scene.schema.effects_detector import BlurModel, DefectsModel, ElectronicsModel, GainModel, LagModel
from phantomgen.scene.schema.functions import (
    EdgeFunctionModel,
    ElementFunctionModel,
    FunctionModel,
    MaterialFunctionModel,
    PlainFunctionModel,
    SvdFunctionsModel,
)
from phantomgen.scene.schema.materials import MaterialModel, MixtureModel, SolutionModel
from phantomgen.scene.schema.motion import DriftModel, MotionModel, RandomWalkModel, SinusoidModel
from phantomgen.scene.schema.objects import (
    BoxModel,
    CapsuleModel,
    CombinedModel,
    ConeModel,
    CylinderModel,
    DifferenceModel,
    EllipsoidModel,
    GroupModel,
    MeshModel,
    PolygonModel,
    ShapeModel,
    SphereModel,
    SweepModel,
    TorusModel,
    TubeShapeModel,
    VoxelsModel,
)
from phantomgen.scene.schema.scan import VolumeModel
from phantomgen.scene.schema.sources import (
    BandModel,
    BowtieModel,
    FilterModel,
    LinesModel,
    MonochromaticModel,
    MultiSourceModel,
    OneSourceModel,
    SourceModel,
    TableModel,
    TubeModel,
)

__all__ = [
    "ApertureModel",
    "AxisModel",
    "BandModel",
    "BlurModel",
    "BowtieModel",
    "BoxModel",
    "CapsuleModel",
    "CardiacSignalModel",
    "ChargeSharingModel",
    "CircularModel",
    "CombinedModel",
    "Composition",
    "ComptonScatterModel",
    "ConeModel",
    "CylinderModel",
    "DeadTimeModel",
    "DefectsModel",
    "DetectorModel",
    "DifferenceModel",
    "DriftModel",
    "EdgeFunctionModel",
    "EffectsModel",
    "ElectronicsModel",
    "ElementFunctionModel",
    "EllipsoidModel",
    "EnergyIntegratingModel",
    "FilterModel",
    "FocalSpotModel",
    "FunctionModel",
    "GainModel",
    "GammaVariateSignalModel",
    "GridModel",
    "GroupModel",
    "HeadModel",
    "HelicalModel",
    "InflowModel",
    "JitterModel",
    "KernelScatterModel",
    "LagModel",
    "LaminographyModel",
    "LatticeModel",
    "LinesModel",
    "MaterialFunctionModel",
    "MaterialModel",
    "MeshModel",
    "MixtureModel",
    "Model",
    "MonochromaticModel",
    "MotionModel",
    "MultiSourceModel",
    "ObjectModel",
    "ObjectMotionModel",
    "OffsetModel",
    "OneSourceModel",
    "OrbitModel",
    "PanelModel",
    "ParallelModel",
    "PhasesModel",
    "PhotonCountingModel",
    "PlainFunctionModel",
    "PlaneModel",
    "PolygonModel",
    "PosesModel",
    "RandomWalkModel",
    "RepeatModel",
    "RespiratorySignalModel",
    "ResponseMatrixModel",
    "RingModel",
    "ScatterModel",
    "SceneModel",
    "ShapeModel",
    "SignalModel",
    "SineSignalModel",
    "SinusoidModel",
    "SolutionModel",
    "SourceModel",
    "SphereModel",
    "SvdFunctionsModel",
    "SweepModel",
    "TableModel",
    "TableSignalModel",
    "TiltModel",
    "TimeModel",
    "TorsoModel",
    "TorusModel",
    "TubeModel",
    "TubeOutputModel",
    "TubeShapeModel",
    "Vector",
    "VolumeModel",
    "VoxelsModel",
    "json_schema",
]


class SceneModel(Model):
    """One scene file: what is scanned, with what, and how the truth is wanted.

    Later objects override earlier ones where they overlap; with `overlap: add` their coefficients add up. What none of
    them fills, from source to panel, is vacuum or the material `background`. Basis functions left out are chosen from
    the materials; a K-edge function that no object needs is left out of the dataset. Sweeps and CAD surfaces become
    triangles, `tessellation` times finer than usual; `auto` takes what the tolerance of the simulation needs.
    """

    version: Literal[1]
    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$")]
    source: SourceModel
    detector: DetectorModel
    geometry: OrbitModel
    panel: PanelModel
    volume: VolumeModel
    effects: EffectsModel = EffectsModel()
    time: TimeModel | None = None
    basis: tuple[FunctionModel, ...] | None = None
    materials: dict[str, MaterialModel] = Field(default_factory=dict)
    objects: Annotated[tuple[ShapeModel, ...], Field(min_length=1)]
    overlap: Literal["replace", "add"] = "replace"
    background: str | None = None
    tessellation: Annotated[PositiveInt, Field(le=1000)] | Literal["auto"] = 1
    seed: NonNegativeInt = 0
    noise: bool = True
    flats: Annotated[PositiveInt, Field(le=100_000)] = 50
    darks: Annotated[NonNegativeInt, Field(le=100_000)] = 1


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema of a scene file, for completion in editors.

    Returns
    -------
    the schema
    """
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **SceneModel.model_json_schema()}
