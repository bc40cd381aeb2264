"""Materials of a scene: compositions, coefficients, and what is mixed from other materials."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import Location, SceneFile, closest
from spectra.elements.attenuation import natural_density
from spectra.elements.named_materials import near
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.materials.mixing import Part, dissolve, mix_by_mass, mix_by_volume

_WAYS = ("composition", "coefficients", "mixture", "solution", "inflow")


def check_material(file: SceneFile, name: str, place: Location) -> None:
    """Refuse a name that is neither a material of the scene nor a material with known density.

    Parameters
    ----------
    file : the scene file
    name : name of a material
    place : place of the name in the file

    Raises
    ------
    SceneError
        With the place in the file where the name stands.
    """
    if name in file.model.materials:
        return
    try:
        density = natural_density(name)
    except InputError as error:
        own = near(name, file.model.materials)
        hint = f"; did you mean {own!r}?" if own else closest(name, file.model.materials)
        known = own is None and "did you mean" in str(error)
        raise file.error(place, str(error) if known else f"unknown material {name!r}{hint}") from None
    if density is None:
        raise file.error(
            place, f"material {name!r} needs a density: give it a name below `materials`, with composition and density"
        )


def scene_materials(file: SceneFile, used: Iterable[str] = ()) -> dict[str, Material]:
    """Create all materials of a scene, then those of `used` that are known by name.

    Materials that no object uses are included.

    Parameters
    ----------
    file : the scene file
    used : names of materials that objects consist of, which `check_material` has passed

    Returns
    -------
    materials by name

    Raises
    ------
    SceneError
        Where a material is impossible, contains itself, or names a part that is neither a material of the scene, nor a
        known name, nor a formula.
    """
    found: dict[str, Material] = {}
    for name in file.model.materials:
        _resolve(file, name, (), found)
    return found | {name: Material(name, None, name) for name in used if name not in found}


def inflow_peaks(file: SceneFile, names: Sequence[str]) -> list[str]:
    """Return the materials that those of objects become.

    Parameters
    ----------
    file : the scene file
    names : materials of objects

    Returns
    -------
    names of further materials

    Raises
    ------
    SceneError
        Where an inflow leads to or from another inflow, or its peak is no known material.
    """
    peaks, known = [], file.model.materials
    for name, material in known.items():
        inflow = material.inflow
        if inflow is None:
            continue
        for key, part in (("rest", inflow.rest), ("peak", inflow.peak)):
            if part in known and known[part].inflow is not None:
                raise file.error(
                    ("materials", name, "inflow", key), f"material {part!r} is an inflow itself: name one that is not"
                )
        if name in names and inflow.peak not in names:
            check_material(file, inflow.peak, ("materials", name, "inflow", "peak"))
            peaks.append(inflow.peak)
    return list(dict.fromkeys(peaks))


def _resolve(file: SceneFile, name: str, outer: tuple[str, ...], found: dict[str, Material]) -> Material:
    """One material, its parts first; `outer` are the materials whose part it is."""
    if name not in found:
        model, place = file.model.materials[name], ("materials", name)
        if sum(getattr(model, way) is not None for way in _WAYS) != 1:
            kinds = "a composition, coefficients, a mixture, a solution or an inflow"
            raise file.error(place, f"material {name!r} needs either {kinds}, and one of them only")
        with file.at(*place):
            found[name] = _made(file, name, model, (*outer, name), found)
    return found[name]


def _made(
    file: SceneFile, name: str, model: schema.MaterialModel, chain: tuple[str, ...], found: dict[str, Material]
) -> Material:
    """The material that a model describes."""

    def part(key: str, amount: float, *place: str) -> Part:
        return _part(file, key, amount, ("materials", name, *place), chain, found)

    if model.mixture is not None:
        parts = [part(key, amount, "mixture", "parts", key) for key, amount in model.mixture.parts.items()]
        mix = mix_by_mass if model.mixture.by == "mass" else mix_by_volume
        return mix(name, parts, model.density)
    if model.solution is not None:
        solvent = part(model.solution.solvent, 0.0, "solution", "solvent")
        solutes = [part(key, c, "solution", "solutes", key) for key, c in model.solution.solutes.items()]
        return dissolve(name, solvent, solutes, model.density)
    if model.inflow is not None:
        rest = model.inflow.rest
        if rest in file.model.materials and rest not in chain:  # also of coefficients, which are not mixed
            return replace(_resolve(file, rest, chain, found), name=name)
        return mix_by_volume(name, [part(rest, 1.0, "inflow", "rest")])
    return Material(name, model.density, model.composition, model.coefficients)


def _part(
    file: SceneFile, key: str, amount: float, place: Location, chain: tuple[str, ...], found: dict[str, Material]
) -> Part:
    """A part: a material of the scene, else a known name or a formula."""
    if key in chain:
        circle = " -> ".join([*chain[chain.index(key) :], key])
        raise file.error(place, f"material {key!r} contains itself ({circle}): give one of them another name")
    with file.at(*place):
        if key in file.model.materials:
            return Part.of(_resolve(file, key, chain, found), amount)
        try:
            return Part.of(key, amount)
        except InputError:
            meant = near(key, file.model.materials)
            if meant is None:
                raise
            raise InputError(f"unknown material {key!r}; did you mean {meant!r}?") from None
