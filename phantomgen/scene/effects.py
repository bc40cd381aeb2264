"""Effects of a scene: from the model of the file to what `simulate` applies."""

from phantomgen.effects import Aperture, ComptonScatter, Effects, FocalSpot, ScatterKernel, TubeOutput
from phantomgen.scene import schema
from phantomgen.scene.effects_detector import detector_effects
from phantomgen.scene.file.scene_file import SceneFile


def scene_effects(file: SceneFile) -> Effects:
    """The effects that a scene asks for.

    Raises
    ------
    SceneError
        Where an effect is impossible, or contradicts another part of the scene.
    """
    model = file.model.effects
    output = model.tube_output
    with file.at("effects", "tube_output"):
        tube_output = None if output is None else TubeOutput(output.sigma, output.recorded)
    return Effects(
        tube_output=tube_output,
        focal_spot=_focal_spot(file),
        aperture=_aperture(file),
        scatter=_scatter(file),
        **detector_effects(file),
    )


def _focal_spot(file: SceneFile) -> FocalSpot | None:
    """Points that photons start from."""
    spot = file.model.effects.focal_spot
    if spot is None:
        return None
    _needs_a_source_point(file, "focal_spot", "a focal spot")
    with file.at("effects", "focal_spot"):
        return FocalSpot(spot.width, spot.width if spot.height is None else spot.height, spot.shape)


def _aperture(file: SceneFile) -> Aperture | None:
    """Sensitive part of pixels."""
    part = file.model.effects.aperture
    if part is None:
        return None
    with file.at("effects", "aperture"):
        return Aperture(part.width, part.width if part.height is None else part.height)


def _scatter(file: SceneFile) -> ScatterKernel | ComptonScatter | None:
    """Model of scattered photons."""
    model = file.model.effects.scatter
    if isinstance(model, schema.KernelScatterModel):
        with file.at("effects", "scatter"):
            return ScatterKernel(model.ratio, model.width)
    if model is None:
        return None
    _needs_a_source_point(file, "scatter", "Compton scatter")
    return ComptonScatter()


def _needs_a_source_point(file: SceneFile, key: str, what: str) -> None:
    """Refuse what parallel rays do not have."""
    if str(file.model.geometry.type) == "parallel":
        raise file.error(
            ("effects", key), f"{what} needs a source point, but the rays are parallel: choose another geometry"
        )
