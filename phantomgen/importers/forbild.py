"""FORBILD phantom files become scenes."""

from math import asin, atan2, cos, degrees
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.importers.forbild_text import Block, Vector, read_blocks
from phantomgen.importers.scene_text import BEAM, flow, nominal_scan
from phantomgen.scene.file.scene_file import SceneFile, closest
from phantomgen.scene.objects.build import objects_of
from spectra.errors import SceneError

# FORBILD files give lengths in cm [mm/cm].
_MM = 10.0
# Photoelectric and Compton attenuation of water at 70 keV [1/mm]: what rho is a multiple of where no formula stands.
_WATER = {"photoelectric": 0.00138, "compton": 0.01788}
# What each type needs, in the names of the file: numbers, and directions.
_NEEDS: dict[str, tuple[set[str], set[str]]] = {
    "Sphere": ({"r"}, set()),
    "Box": ({"dx", "dy", "dz"}, set()),
    "Cylinder": ({"r", "l"}, {"axis"}),
    "Ellipsoid": ({"dx", "dy", "dz"}, set()),
    "Ellipsoid_free": ({"dx", "dy", "dz"}, {"a_x", "a_y", "a_z"}),
    "Ellipt_Cyl": ({"dx", "dy", "l"}, {"a_x", "a_y", "axis"}),
    "Cone": ({"r1", "r2", "l"}, {"axis"}),
}
_ALONG = {"_x": (1.0, 0.0, 0.0), "_y": (0.0, 1.0, 0.0), "_z": (0.0, 0.0, 1.0)}
_NEEDS |= {f"{kind}{end}": (_NEEDS[kind][0], set()) for kind in ("Cylinder", "Cone") for end in _ALONG}
_NEEDS["Ellipt_Cyl_z"] = (_NEEDS["Ellipt_Cyl"][0], set())
# Products of a rotation's columns may differ from those of the unit matrix by this, no unit: digits in the files.
_ORTHOGONAL = 1e-4
_VIEWS = 75

Object = dict[str, Any]


def forbild_scene(path: Path | str) -> str:
    """Convert a FORBILD phantom to the text of a scene, in mm, with a nominal scan around it.

    Parameters
    ----------
    path : the phantom; files that it includes lie beside it

    Returns
    -------
    the YAML

    Raises
    ------
    SceneError
        With file, line and column of what is not understood.

    Notes
    -----
    Later objects replace earlier ones, as in FORBILD. A formula gives a composition of density `rho`; it is called by
    the name in the table of tissues where that gave the density. Without formulas `rho` is the attenuation relative to
    water. An object of density 0 is a vacuum.
    """
    path = Path(path)
    blocks = read_blocks(path)
    if not blocks:
        raise SceneError(f"{path.name}:1:1: there is no object in this file, such as {{ [Sphere: r=5] rho=1 }}")
    materials: dict[str, dict] = {}
    lines = [_line(_object(block, _material(block, materials)), block) for block in blocks]
    name = "".join(c if c.isalnum() or c in "._-" else "-" for c in path.stem).lstrip("._-") or "forbild"
    body = "\n".join(
        [
            "materials:",
            *(f"  {key}: {flow(value)}" for key, value in materials.items()),
            "",
            "objects: # later objects override earlier ones",
            *lines,
            "",
        ]
    )
    return f"{_head(path.name, name)}{_scan(name, body)}\n{body}"


def _object(block: Block, material: str) -> Object:
    """An object of a scene."""
    _check(block)
    v = {key: _MM * value for key, value in block.values.items()}
    found: Object = {"type": "", "material": material}
    center = [_number(v.get(axis, 0.0)) for axis in "xyz"]
    match block.kind.partition("_")[0], block.kind:
        case "Sphere", _:
            found |= {"type": "sphere", "radius": _number(v["r"])}
        case "Box", _:
            found |= {"type": "box", "size": _numbers(v["dx"], v["dy"], v["dz"])}
        case "Ellipsoid", kind:
            found |= {"type": "ellipsoid", "radii": _numbers(v["dx"], v["dy"], v["dz"])}
            if kind == "Ellipsoid_free":
                found["rotation"] = _rotation(block, "a_x", "a_y", "a_z")
        case "Cylinder", _:
            found |= {"type": "cylinder", "radius": _number(v["r"]), "length": _number(v["l"]), "axis": _axis(block)}
        case "Cone", _ if v["r1"] == v["r2"]:
            found |= {"type": "cylinder", "radius": _number(v["r1"]), "length": _number(v["l"]), "axis": _axis(block)}
        case "Cone", _:
            found |= {"type": "cone", "radii": _numbers(v["r1"], v["r2"]), "length": _number(v["l"])}
            found["axis"] = _axis(block)
        case _, kind:  # an elliptic cylinder, which scenes turn in a group
            own = {"type": "cylinder", "radius": _numbers(v["dx"], v["dy"]), "length": _number(v["l"])}
            if kind == "Ellipt_Cyl_z":
                found |= own
            else:
                rotation = _rotation(block, "a_x", "a_y", "axis")
                found = {"type": "group", "rotation": rotation, "objects": [{**own, "material": material}]}
    if any(center):
        found["center"] = center
    if block.planes:
        found["clip"] = [{"normal": _numbers(*n), "offset": _number(_MM * d)} for n, d in block.planes]
    return found


def _check(block: Block) -> None:
    """Refuse types, numbers and directions that are unknown, missing or impossible."""
    if block.kind not in _NEEDS:
        raise SceneError(f"{block.place}: unknown type {block.kind!r}{closest(block.kind, _NEEDS)}")
    numbers, directions = _NEEDS[block.kind]
    for name in block.values.keys() - numbers - {"x", "y", "z"} | block.vectors.keys() - directions:
        known = sorted(numbers | directions | {"x", "y", "z"})
        raise SceneError(f"{block.place}: {block.kind} has no {name!r}: choose from {', '.join(known)}")
    for name in sorted(numbers):
        least_is_zero = name in ("r1", "r2")
        value = block.values.get(name, 0.0)
        if value < 0 or (value == 0 and not least_is_zero):
            raise SceneError(f"{block.place}: {block.kind} needs {name} > 0, got {value:g}")


def _material(block: Block, materials: dict[str, dict]) -> str:
    """Name of the material of an object, which joins `materials`."""
    if block.density is None or block.density < 0:
        raise SceneError(f"{block.place}: {block.kind} needs a density, such as rho=1.05, that is not negative")
    if block.density == 0:
        name, value = "vacuum", {"coefficients": dict.fromkeys(_WATER, 0.0)}
    elif block.formula:
        name, value = f"{block.formula}_{block.density:g}", {"composition": block.formula, "density": block.density}
    else:
        attenuation = {key: _number(block.density * water) for key, water in _WATER.items()}
        name, value = f"rho_{block.density:g}", {"coefficients": attenuation}
    if block.tissue and block.density > 0 and materials.get(block.tissue.lower(), value) == value:
        name = block.tissue.lower()
    materials.setdefault(name, value)
    return name


def _axis(block: Block) -> list[float]:
    """Direction of a cylinder or a cone."""
    direction = _ALONG.get(block.kind[-2:]) or block.vectors.get("axis")
    if direction is None or not any(direction):
        raise SceneError(f"{block.place}: {block.kind} needs a direction axis(a, b, c) that is not zero")
    return _numbers(*direction)


def _rotation(block: Block, *names: str) -> list[float]:
    """Angles about x, then y, then z [degree] that turn the axes into the directions of an object, two or three."""
    given = {name: np.array(block.vectors[name]) for name in names if any(block.vectors.get(name, ()))}
    if len(given) < 2:
        raise SceneError(f"{block.place}: {block.kind} needs two of the directions {', '.join(names)}")
    axes = [given[name] / np.linalg.norm(given[name]) if name in given else None for name in names]
    for i in range(3):
        if axes[i] is None:
            before, behind = axes[(i + 1) % 3], axes[(i + 2) % 3]
            axes[i] = np.cross(before, behind)  # pyright: ignore[reportArgumentType, reportCallIssue]
    turn = np.stack(axes, axis=1)  # pyright: ignore[reportArgumentType, reportCallIssue]
    if np.abs(turn.T @ turn - np.eye(3)).max() > _ORTHOGONAL or np.linalg.det(turn) < 0:
        raise SceneError(f"{block.place}: the directions of {block.kind} must be a right-handed orthogonal frame")
    return _numbers(*_angles(turn))


def _angles(turn: Float[np.ndarray, "3 3"]) -> Vector:
    """Angles [degree] about the fixed x, then y, then z axis of a rotation matrix."""
    y = -asin(min(max(turn[2, 0], -1.0), 1.0))
    if abs(cos(y)) < 1e-9:
        return 0.0, degrees(y), degrees(atan2(-turn[0, 1], turn[1, 1]))
    return degrees(atan2(turn[2, 1], turn[2, 2])), degrees(y), degrees(atan2(turn[1, 0], turn[0, 0]))


def _head(file: str, name: str) -> str:
    """Return the first lines of the scene."""
    return (
        f"# From the FORBILD phantom {file}; centimetres became millimetres. Source, panel and distances are nominal.\n"
        f"version: 1\nname: {name}\n\n{BEAM}"
    )


def _scan(name: str, body: str) -> str:
    """Distances, panel and volume that hold all objects."""
    trial = "geometry: {type: circular, sod: 1, sdd: 2, views: 1}\npanel: {rows: 1, columns: 1, pitch: 1}\n"
    file = SceneFile(f"{name}.yaml", f"{_head(name, name)}{trial}volume: {{voxels: 1, size: 1}}\n{body}")
    corners = np.array([item.shape.bounds for item in objects_of(file)]).reshape(-1, 3)
    reach = np.abs(corners).max(axis=0)
    return nominal_scan(float(np.hypot(reach[0], reach[1])), float(reach[2]), float(reach.max()), _VIEWS)


def _line(found: Object, block: Block) -> str:
    """An object in the scene, with what it is called in the file."""
    note = f"{block.label}, line {block.place.split(':')[-2]}" if block.label else f"line {block.place.split(':')[-2]}"
    return f"  - {flow(found)} # {note}"


def _numbers(*values: float) -> list[float]:
    return [_number(value) for value in values]


def _number(value: float) -> float:
    """Without the noise of arithmetic: twelve digits, and no minus in front of 0."""
    return float(f"{value:.12g}") + 0.0
