"""The source of a scene file, and how its beam differs over the panel."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from phantomgen.effects.tube_fluctuation import BEST_STRENGTH, CurrentModulation
from phantomgen.geometry.config import mount_of, panel_of
from phantomgen.geometry.fan_angles import anode_angles, fan_angles, obliquity
from phantomgen.scene import schema
from phantomgen.scene.beam_profile import Absorber, Profile
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.geometry import panel_distance
from phantomgen.scene.input_files.spectrum_table import read_source
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source

Location = tuple[str | int, ...]


def sources_of(file: SceneFile) -> dict[str, Source]:
    """Create the sources of a scene by name; most scenes have one. A tube takes SpekPy about a second.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    sources by name
    """
    model = file.model.source
    if not isinstance(model, schema.MultiSourceModel):
        return {"source": _source(file, model, ("source",))}
    return {name: _source(file, one, ("source", "sources", name)) for name, one in model.sources.items()}


def _source(file: SceneFile, model: schema.OneSourceModel, at: Location) -> Source:
    """One source behind all its filters, as the panel's centre sees it."""
    source = _unscaled(file, model, at)
    with file.at(*at):
        if isinstance(model, schema.TubeModel) and model.mas is not None:
            return source.scaled(source.photons * model.mas * _pixel_area(file.model))
        return source if model.photons is None else source.scaled(model.photons)


def _unscaled(file: SceneFile, model: schema.OneSourceModel, at: Location) -> Source:
    """Create a source with any number of photons; a tube per cm^2 and mAs at 1 m."""
    with file.at(*at):
        sheets = []
        for i, sheet in enumerate(getattr(model, "filters", ())):
            with file.at(*at, "filters", i):
                sheets.append(Filter(_material(sheet), sheet.thickness))
        if model.bowtie is not None:
            if len(at) > 1:
                raise InputError("a bowtie filter needs a source of its own: of several sources, none may have one")
            with file.at(*at, "bowtie"):
                middle = float(_bowtie_at(file, model.bowtie, np.zeros(1))[0])
                sheets.append(Filter(_material(model.bowtie), middle))
        return _bare(file, model, at).behind(sheets)


def _bare(file: SceneFile, model: schema.OneSourceModel, at: Location) -> Source:
    """A source without filters; a tube per cm^2 and mAs at 1 m."""
    if isinstance(model, schema.TubeModel):
        if (model.photons is None) == (model.mas is None):
            raise InputError("a tube needs either photons per pixel and view, or mas, the charge per view")
        if model.heel and len(at) > 1:
            raise InputError("the heel effect needs a source of its own: of several sources, none may have it")
        if model.modulation is not None and len(at) > 1:
            raise InputError("a modulated current needs a source of its own: of several sources, none may have one")
        return Source.tube(model.kvp, None, model.angle, (), model.anode)
    if isinstance(model, schema.MonochromaticModel):
        return Source.monochromatic(model.energy, model.photons)
    if isinstance(model, schema.LinesModel):
        return Source.of_lines(model.lines)
    if isinstance(model, schema.BandModel):
        return Source.band(model.energy, model.width, model.photons, model.shape)
    with file.at(*at, "file"):
        return read_source(Path(file.name).parent / model.file, model.values, model.energies)


def modulation_of(file: SceneFile) -> CurrentModulation | None:
    """Create the modulation of the tube current.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    the modulation; None where all views have the same current
    """
    model = getattr(file.model.source, "modulation", None)
    if model is None:
        return None
    with file.at("source", "modulation"):
        if (model.strength is None) == (model.factors is None):
            raise InputError("a modulated current needs either a strength, or a factor for each view")
        strength = BEST_STRENGTH if model.strength is None else model.strength
        return CurrentModulation(strength, model.least, model.most, model.factors)


def beam_profile_of(file: SceneFile, source: Source) -> Profile | None:
    """Create the beam profile from bowtie filter and heel effect.

    Parameters
    ----------
    file : the scene file
    source : the source of the scene

    Returns
    -------
    the profile; None where every pixel gets the same beam
    """
    model, panel, mount = file.model.source, panel_of(file.model.panel), mount_of(file.model.panel)
    if isinstance(model, schema.MultiSourceModel):
        return None
    parts: list[tuple[str, Absorber, np.ndarray]] = []
    if model.bowtie is not None:
        with file.at("source", "bowtie"):
            sdd = panel_distance(file.model, "a bowtie filter")
        lengths = _bowtie_at(file, model.bowtie, fan_angles(panel, sdd, mount)) * obliquity(panel, sdd, mount)
        parts.append(("bowtie", _material(model.bowtie), lengths - _bowtie_at(file, model.bowtie, np.zeros(1))))
    if isinstance(model, schema.TubeModel) and model.heel:
        from spectra.source.heel import heel_of  # noqa: PLC0415 - scipy's splines only where they are needed

        with file.at("source", "heel"):
            angles = anode_angles(panel, panel_distance(file.model, "the heel effect"), mount)
            heel = heel_of(source, model.kvp, model.angle, model.anode, float(angles.min()), float(angles.max()))
        amplitudes = heel.amplitudes_at(angles)
        parts += [(f"heel_{i + 1}", curve, amplitudes[i]) for i, curve in enumerate(heel.curves)]
    if not parts:
        return None
    names, absorbers, lengths = zip(*parts, strict=True)
    return Profile(names, absorbers, np.stack(lengths))


def source_fields(file: SceneFile) -> dict[str, tuple[float | str, str | None]]:
    """Return the fields that a dataset states about the source.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    (value, unit) by name
    """
    model = file.model.source
    if isinstance(model, schema.TubeModel):
        return {
            "type": ("Fixed Tube X-ray", None),
            "voltage": (model.kvp, "kV"),
            **_charge(file, model),
            "target_material": (model.anode, None),
            "focal_spot": (_spot_size(file), "mm"),
        }
    if isinstance(model, schema.MultiSourceModel):
        return {"type": ("Fixed Tube X-ray", None), "focal_spot": (_spot_size(file), "mm")}
    if isinstance(model, schema.MonochromaticModel | schema.BandModel):
        return {"type": ("Synchrotron X-ray Source", None)}
    return {}


def _spot_size(file: SceneFile) -> float:
    """Longer side of the focal spot [mm]; 0 for a point."""
    spot = file.model.effects.focal_spot
    return 0.0 if spot is None else max(spot.width, spot.height or 0.0)


def _charge(file: SceneFile, model: schema.TubeModel) -> dict[str, tuple[float, str]]:
    """Charge per view [mAs] that a tube's photons need, by SpekPy's model, where the distance to the panel is known."""
    if model.mas is not None:
        return {"charge": (model.mas, "mA*s")}
    if isinstance(file.model.geometry, schema.ParallelModel | schema.PosesModel):
        return {}
    photons = _unscaled(file, model, ("source",)).photons * _pixel_area(file.model)
    return {"charge": (float(model.photons or 0.0) / photons, "mA*s")}


def composition_name(composition: str | Mapping[str, float]) -> str:
    """Return a name for a material that has only a composition.

    Parameters
    ----------
    composition : formula, name or mass fractions

    Returns
    -------
    the name
    """
    return composition if isinstance(composition, str) else " ".join(composition)


def _material(model: schema.FilterModel | schema.BowtieModel) -> Material:
    """Create the material of a filter."""
    return Material(composition_name(model.composition), model.density, model.composition)


def _pixel_area(scene: schema.SceneModel) -> float:
    """Area of a pixel at the panel's centre [cm^2], as seen at 1 m from the source."""
    panel, sdd = panel_of(scene.panel), panel_distance(scene, "the charge per view, mas,")
    return panel.row_pitch * panel.column_pitch / 100 * (1000 / sdd) ** 2


def _bowtie_at(
    file: SceneFile, model: schema.BowtieModel, fan_angle: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "..."]:
    """Length [mm] that rays in the plane of the orbit have in the bowtie."""
    angles, thickness = np.array(model.angles), np.array(model.thickness)
    where = ("source", "bowtie", "angles")
    if len(angles) != len(thickness):
        raise file.error(where, f"{len(angles)} angles need as many thicknesses, got {len(thickness)}")
    if (np.diff(angles) <= 0).any():
        raise file.error(where, f"angles must ascend, got {angles.tolist()}")
    if angles[0] == 0:  # both sides alike
        angles, thickness = (np.concatenate([sign * a[:0:-1], a]) for sign, a in ((-1, angles), (1, thickness)))
    degrees = np.rad2deg(fan_angle)
    if degrees.min() < angles[0] or degrees.max() > angles[-1]:
        raise file.error(
            where,
            f"the panel sees fan angles of {degrees.min():.4g} .. {degrees.max():.4g} degrees, but the bowtie is given "
            f"for {angles[0]:g} .. {angles[-1]:g}",
        )
    return np.interp(degrees, angles, thickness)
