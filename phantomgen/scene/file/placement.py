"""Random places of the objects that one entry of a scene stands for: inside a region, and apart from each other."""

from collections.abc import Callable
from math import pi
from typing import Any

import numpy as np
from jaxtyping import Float, Int

PLACE_KEYS = ("within", "gap", "fill")
Points = Float[np.ndarray, "item 3"]
Chances = Callable[..., Float[np.ndarray, " item"]]
# What a region needs beside its type and centre.
_REGIONS = {"sphere": {"radius"}, "cylinder": {"radius", "length"}, "box": {"size"}}


def place(
    items: list[dict[str, Any]], rules: dict[str, Any], chances: Chances, refuse: Callable[[tuple, str], Exception]
) -> None:
    """Write the centres of objects, and their radii where they fill a given part of the region.

    Parameters
    ----------
    items : the objects as mappings
    rules : `within`, the region; `gap`, the least distance of the balls around any two objects [mm]; `fill`, the part
        of the region's volume that balls are to fill
    chances : numbers in [0, 1) for all items under a key
    refuse : makes an error out of a key and a sentence
    """
    region = _region(rules, refuse)
    strange = {str(item.get("type")) for item in items} - set(_REACH)
    if strange:
        raise refuse(("within",), f"knows no size of a {min(strange)}: use one of {', '.join(_REACH)}")
    if any("center" in item for item in items):
        raise refuse(("center",), "is drawn by within: leave one of them out")
    reach = np.array([_reach(item) for item in items])
    if not ((reach > 0) & (reach <= _LARGEST)).all():
        return  # sizes that are missing or wrong have better sentences of their own
    if "fill" in rules:
        reach = reach * _scale(items, region, rules["fill"], refuse)
    room = float(min(_rooms(region, reach.max())))
    if room < 0:
        raise refuse(("within",), f"is {-room:.3g} mm too small for an object that reaches {reach.max():.3g} mm")

    def candidates(attempt: int, which: Int[np.ndarray, " ball"]) -> Points:
        u = np.stack([chances("within", axis, str(attempt))[which] for axis in "xyz"], axis=1)
        return _points(region, reach[which], u)

    centers = candidates(0, np.arange(len(items)))
    if "gap" in rules:
        gap = rules["gap"]
        if isinstance(gap, bool) or not isinstance(gap, int | float) or not gap >= 0:
            raise refuse(("gap",), f"must be a distance in mm, 0 or more, got {gap!r}")
        from phantomgen.ops.place_balls import place_balls  # noqa: PLC0415 - numba only where it computes

        centers, placed = place_balls(reach, candidates, float(gap))
        if placed < len(items):
            raise refuse(
                ("gap",), f"leaves room for {placed} of {len(items)} objects: make them fewer or smaller, or fill less"
            )
    for item, center in zip(items, centers.tolist(), strict=True):
        item["center"] = center


def _region(rules: dict[str, Any], refuse: Callable[[tuple, str], Exception]) -> dict[str, Any]:
    """The region as numbers."""
    region = rules.get("within")
    if not isinstance(region, dict) or str(region.get("type")) not in _REGIONS:
        raise refuse(("within",), f"must be a mapping with one of the types {', '.join(_REGIONS)}, got {region!r}")
    kind, given = region["type"], {"center": [0.0, 0.0, 0.0], **region}
    try:
        numbers = {key: np.asarray(given[key], dtype=np.float64) for key in (*_REGIONS[kind], "center")}
    except (KeyError, OverflowError, TypeError, ValueError):
        numbers = {}
    vectors = {"center", "size"}
    right = all(n.shape == ((3,) if key in vectors else ()) and np.isfinite(n).all() for key, n in numbers.items())
    right = right and all((n > 0).all() for key, n in numbers.items() if key != "center")
    if not numbers or not right or set(given) != {"type", "center", *_REGIONS[kind]}:
        raise refuse(
            ("within",), f"of type {kind} needs {' and '.join(sorted(_REGIONS[kind]))} [mm], and may have a center"
        )
    return {"type": kind, **numbers}


def _scale(
    items: list[dict[str, Any]], region: dict[str, Any], fill: Any, refuse: Callable[[tuple, str], Exception]
) -> float:
    """Scale balls so that together they have a part of the region's volume; return the factor."""
    if isinstance(fill, bool) or not isinstance(fill, int | float) or not 0 < fill < 1:
        raise refuse(("fill",), f"must be a part of the region's volume between 0 and 1, got {fill!r}")
    if any(item["type"] != "sphere" for item in items):
        raise refuse(("fill",), "is for spheres only")
    volume = {
        "sphere": lambda: 4 / 3 * pi * region["radius"] ** 3,
        "cylinder": lambda: pi * region["radius"] ** 2 * region["length"],
        "box": lambda: np.prod(region["size"]),
    }[region["type"]]()
    factor = float(np.cbrt(fill * volume / sum(4 / 3 * pi * item["radius"] ** 3 for item in items)))
    for item in items:
        item["radius"] *= factor
    return factor


_LARGEST = 1e7  # mm; shapes refuse what is larger
# Radius of the ball around an object's centre that holds it, whichever way it is turned [mm].
_REACH: dict[str, Callable[[dict[str, Any]], Any]] = {
    "sphere": lambda o: o["radius"],
    "ellipsoid": lambda o: np.max(o["radii"]),
    "cylinder": lambda o: np.hypot(np.max(o["radius"]), o["length"] / 2),
    "tube": lambda o: np.hypot(o["radius"], o["length"] / 2),
    "cone": lambda o: np.hypot(np.max(o["radii"]), o["length"] / 2),
    "capsule": lambda o: o["radius"] + o["length"] / 2,
    "box": lambda o: np.linalg.norm(o["size"]) / 2,
    "torus": lambda o: o["radius"] + o["tube"],
}


def _reach(item: dict[str, Any]) -> float:
    """Radius of the ball around an object [mm], -1 where it is unknown."""
    try:
        return float(_REACH[item["type"]](item))
    except (KeyError, OverflowError, TypeError, ValueError):
        return -1.0


def _rooms(region: dict[str, Any], reach: Any) -> tuple[Any, ...]:
    """Return the half widths of the region for the centre of an object [mm]."""
    if region["type"] == "box":
        return tuple(width / 2 - reach for width in region["size"])
    if region["type"] == "cylinder":
        return region["radius"] - reach, region["length"] / 2 - reach
    return (region["radius"] - reach,)


def _points(region: dict[str, Any], reach: Float[np.ndarray, " item"], u: Points) -> Points:
    """Centres spread evenly over what is left of the region, from numbers in [0, 1)."""
    rooms = _rooms(region, reach)
    if region["type"] == "box":
        return region["center"] + (2 * u - 1) * np.stack(rooms, axis=1)
    turn = 2 * pi * u[:, 0]
    if region["type"] == "cylinder":
        across, along = rooms[0] * np.sqrt(u[:, 1]), rooms[1] * (2 * u[:, 2] - 1)
    else:
        radius, cosine = rooms[0] * np.cbrt(u[:, 1]), 2 * u[:, 2] - 1
        across, along = radius * np.sqrt(1 - cosine**2), radius * cosine
    return region["center"] + np.stack([across * np.cos(turn), across * np.sin(turn), along], axis=1)
