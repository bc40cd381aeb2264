"""What is added to a body: a lesion, a stent, a calcification."""

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np

from phantomgen.scene.bodies.solids import Object, Point, ball
from phantomgen.scene.schema.bodies import BodyModel
from spectra.errors import InputError

# Struts of a stent: rings so far apart [mm], which thin rods join.
_RING_STEP, _JOINTS = 1.5, 6


@dataclass(frozen=True)
class Places:
    """Where additions lie in a body.

    Parameters
    ----------
    organs : place of a lesion [mm] and its usual material, by organ
    vessels : a point in the middle [mm], the direction and the inner radius [mm], by vessel
    """

    organs: Mapping[str, tuple[Point, str]]
    vessels: Mapping[str, tuple[Point, Point, float]]


def added(model: BodyModel, places: Places, scale: float) -> list[Object]:
    """Create what is added to a body.

    Parameters
    ----------
    model : keys of the body
    places : where organs and vessels lie
    scale : of the body, by which lengths are multiplied later

    Returns
    -------
    objects, lowest priority first

    Raises
    ------
    InputError
        Where an organ or a vessel is not known.
    """
    return [*_calcified(model, places, scale), *_stented(model, places, scale), *_lesion(model, places, scale)]


def _lesion(model: BodyModel, places: Places, scale: float) -> list[Object]:
    """A ball in an organ."""
    lesion = model.lesion
    if lesion is None:
        return []
    center, usual = _known(places.organs, lesion.organ, "lesion.organ")
    return [ball(lesion.material or usual, np.add(center, lesion.offset).tolist(), lesion.diameter / 2 / scale)]


def _calcified(model: BodyModel, places: Places, scale: float) -> list[Object]:
    """A ball in the wall of a vessel."""
    plaque = model.calcification
    if plaque is None:
        return []
    center, axis, radius = _known(places.vessels, plaque.vessel, "calcification.vessel")
    across, _ = _beside(axis)
    return [ball("plaque", np.add(center, radius * across).tolist(), plaque.diameter / 2 / scale)]


def _stented(model: BodyModel, places: Places, scale: float) -> list[Object]:
    """Rings of struts that rods join, on the inner side of a vessel."""
    stent = model.stent
    if stent is None:
        return []
    center, axis, radius = _known(places.vessels, stent.vessel, "stent.vessel")
    along, length, strut = np.array(axis) / np.linalg.norm(axis), stent.length / scale, stent.strut / scale
    middle, count = radius - strut / 2, max(2, round(length / _RING_STEP))
    found: list[Object] = [
        {
            "type": "torus",
            "material": stent.material,
            "center": (np.array(center) + along * (length * (k / (count - 1) - 0.5))).round(4).tolist(),
            "radius": round(middle, 4),
            "tube": round(strut / 2, 5),
            "axis": along.round(6).tolist(),
        }
        for k in range(count)
    ]
    across, third = _beside(axis)
    for turn in np.arange(_JOINTS) * 2 * np.pi / _JOINTS:
        place = np.array(center) + middle * (np.cos(turn) * across + np.sin(turn) * third)
        joint = {
            "type": "cylinder",
            "material": stent.material,
            "center": place.round(4).tolist(),
            "axis": along.round(6).tolist(),
        }
        found.append({**joint, "radius": round(0.35 * strut, 5), "length": round(length, 4)})
    return found


def _known(table: Mapping[str, tuple], name: str, key: str) -> tuple:
    """Entry of a table, or a sentence with what there is."""
    if name not in table:
        close = get_close_matches(name, table, 1)
        hint = f": did you mean {close[0]!r}?" if close else f": there are {', '.join(table)}"
        raise InputError(f"{key} {name!r} is not known{hint}")
    return table[name]


def _beside(axis: Point) -> tuple[np.ndarray, np.ndarray]:
    """Two directions across an axis."""
    along = np.array(axis) / np.linalg.norm(axis)
    other = np.eye(3)[np.abs(along).argmin()]
    across = np.cross(along, other)
    across /= np.linalg.norm(across)
    return across, np.cross(along, across)
