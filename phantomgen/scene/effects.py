"""Effects of a scene: from the model of the file to what `simulate` applies, and which contradict each other."""

from typing import Any

from phantomgen.effects import (
    AntiScatterGrid,
    Aperture,
    Blur,
    ComptonScatter,
    Defects,
    Effects,
    ElectronicNoise,
    FocalSpot,
    Gain,
    Lag,
    ScatterKernel,
    TubeOutput,
)
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import SceneFile
from spectra.errors import InputError


def scene_effects(file: SceneFile) -> Effects:
    """Create the effects that a scene requires.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    the effects; None for those that are off

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
        grid=_grid(file),
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


def _grid(file: SceneFile) -> AntiScatterGrid | None:
    """Anti-scatter grid."""
    grid = file.model.effects.grid
    if grid is None:
        return None
    with file.at("effects", "grid"):
        return AntiScatterGrid(grid.primary, grid.scatter)


def _needs_a_source_point(file: SceneFile, key: str, what: str) -> None:
    """Refuse what parallel rays do not have."""
    if str(file.model.geometry.type) == "parallel":
        raise file.error(
            ("effects", key), f"{what} needs a source point, but the rays are parallel: choose another geometry"
        )


def detector_effects(file: SceneFile) -> dict[str, Any]:
    """Create the effects of the detector by their names; None where one is off.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    effects by field name of `Effects`

    Raises
    ------
    SceneError
        Where an effect is impossible, or contradicts another part of the scene.
    """
    _check_contradictions(file)
    found: dict[str, Any] = {}
    for name, make in {"blur": _blur, "gain": _gain, "lag": _lag, "electronics": _electronics}.items():
        model = getattr(file.model.effects, name)
        with file.at("effects", name):
            found[name] = None if model is None else make(model)
    return {**found, "defects": _defects(file)}


def _check_contradictions(file: SceneFile) -> None:
    """Refuse effects that the scene's detector or source cannot have."""
    scene, effects = file.model, file.model.effects
    if not isinstance(scene.detector, schema.EnergyIntegratingModel):
        for name, what in (("electronics", "stays below the thresholds of"), ("lag", "is not known of")):
            if getattr(effects, name) is not None:
                raise file.error(
                    ("effects", name),
                    f"{name} {what} detectors that count photons: leave it out, or use a detector of type "
                    "energy_integrating",
                )
    if effects.lag is not None and scene.source.type == "switching":
        raise file.error(("effects", "lag"), "is known for sources that do not take turns, got type switching")
    if effects.electronics is not None and effects.electronics.offset > 0 and scene.darks == 0:
        raise file.error(("effects", "electronics", "offset"), "needs darks to be taken off again, got darks: 0")


def _blur(model: schema.BlurModel) -> Blur:
    """By its MTF, or by its width."""
    if model.fwhm is not None and model.mtf is None and model.frequency is None:
        return Blur.of_fwhm(model.fwhm)
    if model.mtf is not None and model.frequency is not None and model.fwhm is None:
        return Blur.of_mtf(model.mtf, model.frequency)
    given = ", ".join(name for name in ("mtf", "frequency", "fwhm") if getattr(model, name) is not None)
    raise InputError(f"give mtf with its frequency in 1/mm, or fwhm in mm alone, got {given or 'none of them'}")


def _gain(model: schema.GainModel) -> Gain:
    """The gain map."""
    return Gain(**dict(model))


def _lag(model: schema.LagModel) -> Lag:
    """The afterglow."""
    return Lag(model.fractions, model.decays)


def _electronics(model: schema.ElectronicsModel) -> ElectronicNoise:
    """Noise and offset."""
    return ElectronicNoise(model.sigma, model.offset)


def _defects(file: SceneFile) -> Defects | None:
    """Defects; their lines lie on the panel, and leave something of it."""
    model, panel = file.model.effects.defects, file.model.panel
    if model is None:
        return None
    with file.at("effects", "defects"):
        defects = Defects(**dict(model))
        if defects.mask(file.model.seed, panel.rows, panel.columns).all():
            raise InputError(f"no pixel of {panel.rows} x {panel.columns} is left that measures")
    return defects
