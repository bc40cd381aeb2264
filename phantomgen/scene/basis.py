"""The basis of a scene: the functions of the file, or those that its materials need."""

from collections.abc import Mapping, Sequence
from math import ceil

from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import Location, SceneFile
from spectra.basis.basis import Basis, BasisFunction
from spectra.basis.change import svd_functions
from spectra.detector.detector import AnyDetector
from spectra.elements.attenuation import Composition, edge_energy, mass_fractions, symbol
from spectra.elements.named_materials import near
from spectra.errors import InputError
from spectra.materials.material import SAME_EDGE, Material
from spectra.source.source import Source


def scene_basis(
    file: SceneFile,
    materials: Mapping[str, Material],
    used: Sequence[str],
    source: Source,
    detector: AnyDetector,
) -> Basis:
    """Return the basis of the file, or photoelectric, Compton and one element function per K edge that channels see.

    Parameters
    ----------
    file : the scene file
    materials : all materials of the scene
    used : names of those that an object or the background consists of
    source, detector : what the scan is seen with

    Returns
    -------
    raw basis functions
    """
    models = file.model.basis
    if models is None:
        kinds = [BasisFunction("photoelectric"), BasisFunction("compton")]
        elements = _edge_elements([materials[name] for name in used], detector)
        return Basis((*kinds, *(BasisFunction("element", element=e) for e in elements)))
    functions: list[BasisFunction] = []
    for i, model in enumerate(models):
        with file.at("basis", i):
            if isinstance(model, schema.SvdFunctionsModel):
                functions += _svd(file, i, model, materials, source, detector)
            elif isinstance(model, schema.MaterialFunctionModel):
                composition = _composition(file, model.material, ("basis", i, "material"), materials)
                functions.append(BasisFunction("material", name=model.material, composition=composition))
            elif isinstance(model, schema.EdgeFunctionModel):
                edge = {"edge_energy": model.edge_energy, "edge_width": model.width, "element": model.element}
                functions.append(BasisFunction(model.type, **edge))
            else:
                functions.append(BasisFunction(model.type, element=getattr(model, "element", None)))
    with file.at("basis"):
        return Basis(tuple(functions))


def needed(basis: Basis, materials: Sequence[Material]) -> Basis:
    """Remove the K-edge functions that no material uses.

    Parameters
    ----------
    basis : raw basis functions
    materials : materials of the scene

    Returns
    -------
    the basis without them
    """
    functions = tuple(f for f in basis.functions if f.edge_energy is None or any(_uses(m, f) for m in materials))
    return Basis(functions, basis.reference_energy)


def _svd(
    file: SceneFile,
    index: int,
    model: schema.SvdFunctionsModel,
    materials: Mapping[str, Material],
    source: Source,
    detector: AnyDetector,
) -> tuple[BasisFunction, ...]:
    """Singular vectors over the open-beam counts of all channels, in bins of at most 1 keV."""
    compositions = {
        name: _composition(file, name, ("basis", index, "materials", i), materials)
        for i, name in enumerate(model.materials)
    }
    low = detector.lowest
    edges = [e for c in compositions.values() for e in Material("", 1.0, c).k_edges(low, source.maximum)]
    grid = source.grid(low, max(1, ceil(source.maximum - low)), (*detector.breaks, *edges))
    energies, photons = source.sampled(grid)
    detected = (detector.response(energies) * photons).sum(axis=0)
    seen = detected > 0
    return svd_functions(compositions, model.count, energies.nodes[seen], detected[seen])


def _composition(file: SceneFile, name: str, place: Location, materials: Mapping[str, Material]) -> Composition:
    """Return the composition of a material of the scene, else the name or formula itself."""
    if name in materials:
        composition = materials[name].composition
        if composition is None:
            raise file.error(
                place, f"material {name!r} is given by coefficients, but a basis function needs a composition"
            )
        return composition
    with file.at(*place):
        try:
            mass_fractions(name)
        except InputError:
            meant = near(name, materials)
            if meant is None:
                raise
            raise InputError(f"unknown material {name!r}; did you mean {meant!r}?") from None
    return name


def _edge_elements(materials: Sequence[Material], detector: AnyDetector) -> list[str]:
    """Elements whose K edge lies between the lowest threshold and the highest energy."""
    low, high = detector.lowest, max(channel.upper for channel in detector.channels)
    numbers = {number for m in materials if m.composition is not None for number, _ in mass_fractions(m.composition)}
    edges = {name: edge_energy(name) for name in map(symbol, numbers)}
    return sorted((e for e, edge in edges.items() if low < edge < high), key=edges.__getitem__)


def _uses(material: Material, function: BasisFunction) -> bool:
    """Return whether a material has a coefficient for a K-edge function, or a K edge at the function's own."""
    if material.coefficients is not None:
        return material.coefficients.get(function.name, 0.0) > 0
    edge = float(function.edge_energy or 0.0)
    return bool(material.k_edges(edge - SAME_EDGE, edge + SAME_EDGE))
