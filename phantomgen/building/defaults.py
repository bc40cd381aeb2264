"""What a scene that is built in Python has where nothing is said: a tube, five channels, and a circle that fits."""

from math import ceil, floor, log10
from typing import Any

import numpy as np

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.objects.build import objects_of
from phantomgen.shapes import Placed, rotation_matrix

SOURCE = {"type": "tube", "kvp": 120, "filters": [{"composition": "Al", "thickness": 2.5}], "photons": 200_000.0}
# Thresholds [keV] at the K edges of iodine (33.17) and gadolinium (50.24), the commonest contrast agents.
DETECTOR = {"type": "photon_counting", "thresholds": [20, 33.2, 50.2, 65, 80]}
VIEWS, TEST_VIEWS, PIXELS, VOXELS = 90, 10, 128, 64
MAGNIFICATION = 1.6
LEAST_SOURCE_DISTANCE = 500.0  # mm; larger objects have four times their radius
MARGIN = 1.1  # of the volume and the panel, beyond the objects
_AIR = 6  # pixels of the panel across, together on both sides, that see nothing but air
_TURNS = 16  # in which the radius is measured


def completed(given: dict[str, Any], name: str) -> dict[str, Any]:
    """Add the default of every section that is missing, or of its keys where the section says not all.

    Parameters
    ----------
    given : keys of a scene file
    name : of the scene in messages

    Returns
    -------
    keys of a complete scene file
    """
    probe = {"volume": {"voxels": 1, "size": 1}, "geometry": circle(1.0), "panel": panel_for(1.0, 1.0, circle(1.0))}
    values = _merged(given, {"source": SOURCE, "detector": DETECTOR})
    if all(_complete(values.get(key)) for key in probe):
        return values
    radius, half = reach(SceneFile(name, "", given=_merged(values, probe)))
    orbit = _merged(values, {"geometry": circle(radius)})
    seen = orbit["geometry"] if {"sod", "sdd"} <= orbit["geometry"].keys() else circle(radius)
    size = {"voxels": VOXELS, "size": _round(2 * MARGIN * max(radius, half))}
    return _merged(orbit, {"panel": panel_for(radius, half, seen, values.get("panel")), "volume": size})


def reach(file: SceneFile) -> tuple[float, float]:
    """Measure how far the objects of a scene reach.

    Parameters
    ----------
    file : the scene

    Returns
    -------
    largest distance from the z axis and from the plane z = 0 [mm]
    """
    radius = half = 0.0
    for item in objects_of(file):
        half = max(half, float(np.abs([bound[2] for bound in item.shape.bounds]).max()))
        for turn in np.arange(_TURNS) * np.pi / _TURNS:
            low, high = Placed(item.shape, rotation_matrix((0.0, 0.0, float(turn))), np.zeros(3)).bounds
            radius = max(radius, abs(float(low[0])), abs(float(high[0])))
    return radius, half


def circle(radius: float) -> dict[str, Any]:
    """Return the circular orbit around objects.

    Parameters
    ----------
    radius : of the objects about the z axis [mm]

    Returns
    -------
    section ``geometry``
    """
    sod = max(LEAST_SOURCE_DISTANCE, _round(4 * radius))
    return {"type": "circular", "sod": sod, "sdd": MAGNIFICATION * sod, "views": VIEWS, "test_views": TEST_VIEWS}


def panel_for(radius: float, half: float, orbit: dict[str, Any], given: Any = None) -> dict[str, Any]:
    """Return the panel that sees all of the objects: square, unless rows, columns or the pitch are given.

    Parameters
    ----------
    radius, half : reach of the objects from the z axis and from the plane z = 0 [mm]
    orbit : section ``geometry``
    given : what the scene says of the section ``panel``

    Returns
    -------
    section ``panel``
    """
    said = given if isinstance(given, dict) else {}
    sod, sdd = float(orbit["sod"]), float(orbit["sdd"])
    across = sdd * radius / np.sqrt(max(sod**2 - radius**2, 1e-6 * sod**2))
    up = sdd * half / max(sod - radius, 1e-3 * sod)
    across, up = float(across), float(up)
    width, height = 2 * MARGIN * across, 2 * MARGIN * up
    pitch = said.get("pitch")
    if isinstance(pitch, float | int) and pitch > 0:
        return {"rows": max(1, ceil(height / pitch)), "columns": max(1, ceil(width / pitch)), "pitch": pitch}
    counts = {key: said.get(key, PIXELS) for key in ("rows", "columns")}
    rows, columns = (n if isinstance(n, int) and n > 0 else PIXELS for n in counts.values())
    fine = max(rows / 2, rows - _AIR), max(columns / 2, columns - _AIR)
    return {**counts, "pitch": _round(max(height / rows, width / columns, 2 * up / fine[0], 2 * across / fine[1]))}


def _merged(given: dict[str, Any], defaults: dict[str, Any]) -> dict[str, Any]:
    """Sections with what they lack; a section of another type than the default's stays as it is."""
    values = dict(given)
    for key, default in defaults.items():
        own = values.get(key)
        if own is None:
            values[key] = dict(default)
        elif isinstance(own, dict) and own.get("type", default.get("type")) == default.get("type"):
            values[key] = {**default, **own}
    return values


def _complete(section: Any) -> bool:
    """Return whether a section needs no size of the objects."""
    enough = ({"voxels", "size"}, {"rows", "columns", "pitch"}, {"type", "sod", "sdd"})
    return isinstance(section, dict) and (any(keys <= section.keys() for keys in enough) or _is_other(section))


def _is_other(section: dict[str, Any]) -> bool:
    """Return whether a section is an orbit of another type than the default's."""
    return section.get("type", "circular") != "circular"


def _round(value: float) -> float:
    """Two digits, rounded up."""
    if not 0 < value < np.inf:
        return 1.0
    step = 10.0 ** (floor(log10(value)) - 1)
    return float(f"{ceil(value / step - 1e-9) * step:.6g}")
