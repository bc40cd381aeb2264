"""Poses of a CTSimU scenario: source, panel and stage in a world frame, with deviations and drifts, view by view.

What is not known to the reconstruction (``known_to_reconstruction: false``) is left out.

References
----------
.. [1] https://bamresearch.github.io/ctsimu-scenarios/geometry.html, format 1.2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

Vector = Float[np.ndarray, "3"]
_UNITS = {"mm": 1.0, "cm": 10.0, "m": 1e3, "um": 1e-3, "nm": 1e-6, "deg": np.pi / 180, "rad": 1.0, "px": 1.0}
_MOST_VIEWS = 1_000_000


@dataclass(frozen=True)
class _Frame:
    """A place and three axes in the world, of unit length."""

    center: Vector
    u: Vector
    w: Vector

    @property
    def axes(self) -> Float[np.ndarray, "3 3"]:
        """Axes u, v and w, one per row."""
        return np.stack([self.u, np.cross(self.w, self.u), self.w])

    def turned(self, axis: Vector, angle: float, pivot: Vector) -> "_Frame":
        """Turn about an axis through a point."""
        turn = _rotation(axis, angle)
        return _Frame(pivot + turn @ (self.center - pivot), turn @ self.u, turn @ self.w)


def scenario_geometry(scenario: Mapping[str, Any]) -> Geometry:
    """Create the poses in the frame of the stage, which turns with the sample.

    Parameters
    ----------
    scenario : content of the JSON file

    Returns
    -------
    poses of all views

    Raises
    ------
    GeometryError
        When a key is missing or has another form.
    """
    geometry, scan = _mapping(scenario, "geometry"), _mapping(scenario, "acquisition")
    count = int(number(scan, "number_of_projections"))
    if not 1 <= count <= _MOST_VIEWS:
        raise GeometryError(f"number_of_projections must be 1 to {_MOST_VIEWS}, got {count}")
    start, stop = (number(scan, f"{end}_angle") for end in ("start", "stop"))
    steps = count - 1 if scan.get("include_final_angle") else count
    sense = -1.0 if scan.get("direction") == "CW" else 1.0
    detector = _mapping(scenario, "detector")
    pitch = _mapping(detector, "pixel_pitch")
    rows, columns = (int(number(detector, name)) for name in ("rows", "columns"))
    panel = Panel(rows, columns, (number(pitch, "v"), number(pitch, "u")))
    parts = {name: _mapping(geometry, name) for name in ("source", "detector", "stage")}
    kind = parts["source"].get("type") or "cone"
    if kind not in ("cone", "parallel"):
        raise GeometryError(f"geometry.source.type is {kind!r}: cone and parallel are read")
    poses = []
    for view in range(count):
        at = view / max(count - 1, 1)
        angle = sense * (start + (stop - start) * view / max(steps, 1))
        source, face, stage = (_placed(name, part, at) for name, part in parts.items())
        stage = _deviated("stage", stage.turned(stage.w, angle, stage.center), parts["stage"], at)
        source, face = (_deviated(name, one, parts[name], at) for name, one in (("source", source), ("detector", face)))
        into = stage.axes
        across, down, _ = face.axes @ into.T
        poses.append(
            (into @ (source.center - stage.center), into @ (face.center - stage.center), across, down, into @ source.w)
        )
    source, center, across, down, beam = (np.array(vectors) for vectors in zip(*poses, strict=True))
    vectors = center, panel.column_pitch * across, panel.row_pitch * down
    if kind == "parallel":
        return Geometry.parallel(beam, *vectors, panel, np.arctan2(-beam[:, 1], -beam[:, 0]))
    angles = np.unwrap(np.arctan2(source[:, 1], source[:, 0]))
    return Geometry(source, *vectors, panel, angles, _kind(source, across))


def number(parent: Mapping[str, Any], name: str, at: float = 0.0, default: float | None = None) -> float:
    """Return the value of a parameter in mm, radians or pixels, with the drifts that a reconstruction may know.

    Parameters
    ----------
    parent : mapping that holds it
    name : of the parameter
    at : part of the scan, 0 to 1
    default : where it is missing; None to refuse that

    Returns
    -------
    the value

    Raises
    ------
    GeometryError
        When it is missing, no finite number, or drifts by a file.
    """
    entry = parent.get(name)
    if isinstance(entry, int | float) and not isinstance(entry, bool):
        entry = {"value": entry}
    if not isinstance(entry, dict) or entry.get("value") is None:
        if default is not None:
            return default
        raise GeometryError(f"the key {name} is missing, or has no value")
    unit, drifts = entry.get("unit"), entry.get("drifts")
    total = _number(name, entry["value"], unit)
    for drift in drifts if isinstance(drifts, list) else ():
        if not isinstance(drift, dict) or drift.get("known_to_reconstruction") is False:
            continue
        values = drift.get("value")
        if values is None:
            raise GeometryError(f"{name} drifts by a file, {drift.get('file')!r}, which is not read")
        values = [_number(name, value, drift.get("unit") or unit) for value in np.ravel(values).tolist()]
        if not values:
            raise GeometryError(f"{name} drifts by an empty list")
        total += float(np.interp(at * (len(values) - 1), np.arange(len(values)), values))
    return total


def unknown_parts(scenario: Mapping[str, Any]) -> bool:
    """Tell whether a scenario has deviations or drifts of poses that a reconstruction may not know.

    Parameters
    ----------
    scenario : content of the JSON file

    Returns
    -------
    True where it has
    """

    def search(node: Any) -> bool:
        if isinstance(node, dict):
            return node.get("known_to_reconstruction") is False or any(map(search, node.values()))
        return isinstance(node, list) and any(map(search, node))

    return search(scenario.get("geometry"))


def _placed(name: str, part: Mapping[str, Any], at: float) -> _Frame:
    """A part of the scanner without its deviations."""
    center, u, w = (_vector(_mapping(part, key), "xyz", at) for key in ("center", "vector_u", "vector_w"))
    lengths = np.linalg.norm(u), np.linalg.norm(w)
    if min(lengths) == 0 or abs(u @ w) > 1e-6 * lengths[0] * lengths[1]:
        raise GeometryError(f"geometry.{name}: vector_u and vector_w must be orthogonal and not zero")
    return _Frame(center, u / lengths[0], w / lengths[1])


def _deviated(name: str, frame: _Frame, part: Mapping[str, Any], at: float) -> _Frame:
    """Apply the known deviations one after the other."""
    for deviation in part.get("deviations") or ():
        if not isinstance(deviation, dict):
            raise GeometryError(f"geometry.{name}.deviations must be a list of mappings")
        if deviation.get("known_to_reconstruction") is False:
            continue
        axis, amount = _axis(name, frame, deviation.get("axis"), at), number(deviation, "amount", at)
        if deviation.get("type") == "translation":
            frame = replace(frame, center=frame.center + amount * axis)
        elif deviation.get("type") == "rotation":
            pivot = deviation.get("pivot")
            frame = frame.turned(axis, amount, frame.center if pivot is None else _point(name, frame, pivot, at))
        else:
            raise GeometryError(
                f"geometry.{name}.deviations: a type is translation or rotation, got {deviation.get('type')!r}"
            )
    return frame


def _axis(name: str, frame: _Frame, axis: Any, at: float) -> Vector:
    """A direction in the world, of unit length."""
    if isinstance(axis, str) and axis in ("x", "y", "z"):
        return np.eye(3)["xyz".index(axis)]
    if isinstance(axis, str) and axis in ("u", "v", "w"):
        return frame.axes["uvw".index(axis)]
    if isinstance(axis, dict):
        local = "u" in axis
        found = _vector(axis, "uvw" if local else "xyz", at)
        if np.linalg.norm(found) > 0:
            found = frame.axes.T @ found if local else found
            return found / np.linalg.norm(found)
    raise GeometryError(f"geometry.{name}.deviations: an axis is x, y, z, u, v, w or a vector, got {axis!r}")


def _point(name: str, frame: _Frame, pivot: Any, at: float) -> Vector:
    """A point in the world."""
    if not isinstance(pivot, dict):
        raise GeometryError(f"geometry.{name}.deviations: a pivot must be a mapping of coordinates, got {pivot!r}")
    if "u" in pivot:
        return frame.center + frame.axes.T @ _vector(pivot, "uvw", at)
    return _vector(pivot, "xyz", at)


def _kind(source: Float[np.ndarray, "view 3"], across: Float[np.ndarray, "view 3"]) -> str:
    """Name of the orbit."""
    if np.abs(across[:, 2]).max() > 1e-9:
        return "free"
    if np.ptp(source[:, 2]) > 1e-9:
        return "helical"
    return "circular" if np.abs(source[:, 2]).max() < 1e-9 else "free"


def _vector(parent: Mapping[str, Any], axes: str, at: float) -> Vector:
    return np.array([number(parent, axis, at) for axis in axes])


def _number(name: str, value: Any, unit: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise GeometryError(f"{name} must be a number, got {value!r}")
    if unit is None:
        return float(value)
    if not isinstance(unit, str) or unit not in _UNITS:
        raise GeometryError(f"{name} has the unit {unit!r}: choose from {', '.join(_UNITS)}")
    return float(value) * _UNITS[unit]


def _mapping(parent: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = parent.get(name)
    if not isinstance(found, dict):
        raise GeometryError(f"the key {name} is missing, or no mapping")
    return found


def _rotation(axis: Sequence[float] | Vector, angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about a unit vector, right-handed (Rodrigues)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
