"""Views from a YAML file with the keys ``geometry`` and ``panel``, as scene files have them; other keys do not matter.

The poses are nominal: jitter and motion of a scene are no business of a reconstruction.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from phantomgen.geometry import orbits
from phantomgen.geometry.fan_angles import fan_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.pose_table import read_poses
from phantomgen.geometry.poses import Geometry
from spectra.errors import Error, InputError

_TURNING = {"views", "angles", "arc", "start"}
_KEYS = {
    "circular": {"sod", "sdd", *_TURNING},
    "helical": {"sod", "sdd", "views", "pitch", "turns", "range", "start"},
    "laminography": {"sod", "sdd", "tilt", *_TURNING},
    "parallel": {"distance", "tilt", *_TURNING},
    "poses": {"file"},
}
_ALWAYS = {"type", "test_views", "jitter"}
_PANEL = {"rows", "columns", "pitch", "offset", "tilt"}
Values = dict[str, Any]


def read_geometry_file(path: Path) -> Geometry:
    """Read views in the order of a dataset: training views, then test views.

    Parameters
    ----------
    path : YAML file

    Returns
    -------
    nominal poses

    Raises
    ------
    InputError
        When the file cannot be read, lacks a key, or has one that does not belong there.
    GeometryError
        When the views are impossible.
    """
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path} cannot be read as a geometry: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError):
        raise InputError(f"{path} cannot be read as a geometry: it is not YAML text") from None
    place = _Place(path)
    values = place.mapping("", values)
    panel_values, orbit = (place.mapping(name, values.get(name)) for name in ("panel", "geometry"))
    place.known("panel", panel_values, _PANEL)
    kind = orbit.get("type")
    if kind not in _KEYS:
        raise InputError(f"{path}: geometry.type must be one of {', '.join(_KEYS)}, got {kind!r}")
    place.known("geometry", orbit, _KEYS[kind] | _ALWAYS)
    panel, mount = _panel(place, panel_values)
    try:
        return mounted(_orbit(place, kind, orbit, panel, mount), mount)
    except (TypeError, KeyError) as error:
        raise InputError(f"{path}: geometry of type {kind} is incomplete or holds something else: {error}") from None
    except Error as error:
        raise type(error)(f"{path}: {error}") from None


class _Place:
    """Complaints that name the file."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def mapping(self, name: str, values: Any) -> Values:
        """A mapping that must be there."""
        if not isinstance(values, dict):
            raise InputError(f"{self.path}: {name or 'the file'} must be a mapping with keys, as in scene files")
        return values

    def known(self, name: str, values: Values, keys: set[str]) -> None:
        """Refuse keys that mean nothing."""
        for key in sorted(set(map(str, values)) - keys):
            raise InputError(f"{self.path}: {name}.{key} is no key here: use {', '.join(sorted(keys))}")

    def number(self, name: str, values: Values, default: float | None = None) -> float:
        """A number; one without default must be there."""
        group, _, key = name.partition(".")
        value = values.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise InputError(f"{self.path}: {group}.{key} must be a number, got {value!r}")
        return float(value)

    def count(self, name: str, values: Values, default: int | None = None) -> int:
        """Read a number that is whole and not negative."""
        value = self.number(name, values, default)
        if value != int(value) or value < 0:
            raise InputError(f"{self.path}: {name} must be a whole number, 0 or more, got {value:g}")
        return int(value)


def _panel(place: _Place, values: Values) -> tuple[Panel, Mount]:
    """The pixel grid and how it stands."""
    pitch = values.get("pitch")
    pitch = tuple(map(float, pitch)) if isinstance(pitch, list) else place.number("panel.pitch", values)
    panel = Panel(place.count("panel.rows", values), place.count("panel.columns", values), pitch)  # type: ignore[arg-type]
    offset, tilt = (values.get(name) or {} for name in ("offset", "tilt"))
    shift = [place.number(f"panel.{name}", place.mapping("panel.offset", offset), 0.0) for name in ("columns", "rows")]
    names = ("columns", "rows", "in_plane")
    turns = np.deg2rad([place.number(f"panel.{name}", place.mapping("panel.tilt", tilt), 0.0) for name in names])
    return panel, Mount((shift[0], shift[1]), tuple(turns.tolist()))  # type: ignore[arg-type]


def _orbit(place: _Place, kind: str, orbit: Values, panel: Panel, mount: Mount) -> Geometry:
    """Poses of a panel that is not yet mounted."""

    def number(name: str, default: float | None = None) -> float:
        return place.number(f"geometry.{name}", orbit, default)

    tests = place.count("geometry.test_views", orbit, 0)
    if kind == "poses":
        return _table(read_poses(place.path.parent / str(orbit["file"]), panel), tests)
    if kind == "helical":
        return _helix(place, orbit, panel, tests)
    tilt = float(np.deg2rad(number("tilt", 0.0)))
    angles = _angles(place, orbit, tests, 180.0 if kind == "parallel" else 360.0, lambda: _fan(panel, orbit, mount))
    if kind == "circular":
        return Geometry.circular(number("sod"), number("sdd"), angles, panel)
    if kind == "laminography":
        return orbits.laminography(number("sod"), number("sdd"), angles, tilt, panel)
    return orbits.parallel(number("distance"), angles, panel, tilt)


def _angles(place: _Place, orbit: Values, tests: int, whole: float, fan: Callable[[], float]) -> np.ndarray:
    """Angles of training views, then of test views [rad]."""
    if ("views" in orbit) == ("angles" in orbit):
        raise InputError("geometry needs either views, the number of them, or angles, a list in degrees")
    if "angles" in orbit:
        listed = np.array(orbit["angles"], dtype=float)
        return np.deg2rad(np.append(listed, orbits.between(listed, tests)))
    short = orbit.get("arc") == "short"
    arc = orbits.short_arc(fan()) if short else place.number("geometry.arc", orbit, whole)
    views = place.count("geometry.views", orbit)
    return orbits.spread_angles(views, tests, arc, place.number("geometry.start", orbit, 0.0))


def _fan(panel: Panel, orbit: Values, mount: Mount) -> float:
    """Largest fan angle, outer edges of pixels included [rad]."""
    edges = Panel(panel.rows + 1, panel.columns + 1, panel.pitch)
    return float(np.abs(fan_angles(edges, orbit["sdd"], mount)).max())


def _helix(place: _Place, orbit: Values, panel: Panel, tests: int) -> Geometry:
    """A helix whose middle is at z = 0."""
    if ("turns" in orbit) == ("range" in orbit):
        raise InputError("a helical geometry needs either turns, the number of them, or range, its rise in mm")
    names = ("sod", "sdd", "pitch")
    sod, sdd, pitch = (place.number(f"geometry.{name}", orbit) for name in names)
    if "range" in orbit and pitch == 0:
        raise InputError("a helical geometry of pitch 0 covers no range: give turns")
    start = place.number("geometry.start", orbit, 0.0)
    turns = (
        place.number("geometry.turns", orbit)
        if "turns" in orbit
        else place.number("geometry.range", orbit) / abs(pitch)
    )
    angles = orbits.spread_angles(place.count("geometry.views", orbit), tests, 360.0 * turns, start)
    return orbits.helical(sod, sdd, angles, pitch, panel, -pitch * (turns / 2 + start / 360))


def _table(poses: Geometry, tests: int) -> Geometry:
    """Rows of a table, those for tests last."""
    rows = len(poses)
    if tests >= rows:
        raise InputError(f"of {rows} poses, {tests} cannot be test views: some must be left to train")
    picked = ((np.arange(tests) + 0.5) * rows / max(tests, 1)).astype(int)
    return poses[np.append(np.delete(np.arange(rows), picked), picked)]
