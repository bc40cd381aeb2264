"""Scenes with random numbers in them: every distribution of a scene file becomes the value that a seed draws.

A value has a key of its own: the seed, where it stands in the file (objects by their `name` where they have one), and
the number of the item where an object is drawn several times. The key, hashed, is that of a counter-based generator
(Philox, Salmon et al. 2011, doi:10.1145/2063384.2063405), and item i takes its i-th number. So no value depends on how
many others are drawn, nor in which order. Only places with a `gap` look at each other.
"""

from collections.abc import Callable
from dataclasses import dataclass
from hashlib import sha256
from math import log
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.scene.file.placement import PLACE_KEYS, place
from spectra.errors import shortened

Location = tuple[str | int, ...]
_Keys = tuple[Any, ...]  # a location whose keys may be numbers, such as energies of lines
Refuse = Callable[[Location, str], Exception]
Path = tuple[str, ...]

MOST_OBJECTS = 1_000_000  # of a scene, and of one entry
DISTRIBUTIONS = {
    "uniform": "two numbers [lowest, highest]",
    "log_uniform": "two positive numbers [lowest, highest]",
    "normal": "two numbers [mean, standard deviation], the second positive",
    "integers": "two whole numbers [lowest, highest]",
    "choice": "a list of at least one value",
}
# Lists whose entries may be drawn several times and have a name.
_OBJECT_LISTS = ("objects", "shapes", "cut")


class DrawnObject(dict):
    """Object of a drawn scene, with the entry of the file it came from.

    Parameters
    ----------
    values : keys of the object
    source : index of the entry
    item : number of the object among those drawn from the entry; None where there is no `count`
    """

    def __init__(self, values: dict[str, Any], source: int, item: int | None) -> None:
        super().__init__(values)
        self.source, self.item = source, item


def draw(values: dict[str, Any], refuse: Refuse) -> dict[str, Any]:
    """Draw all random numbers of a scene from its seed.

    Parameters
    ----------
    values : mapping of a scene file
    refuse : makes an error out of a place in the file and a sentence

    Returns
    -------
    the scene with numbers in place of distributions
    """
    seed = values.get("seed", 0)
    if isinstance(seed, dict):
        raise refuse(("seed",), "must be a number: all other values are drawn from it")
    return _Draw(str(seed), refuse).values(values, (), (), 1)[0]


def source_place(values: Any, location: Location) -> Location:
    """Return the place in the file of an entry at `location` in the drawn scene.

    Parameters
    ----------
    values : mapping of the drawn scene
    location : keys and indices in the drawn scene

    Returns
    -------
    keys and indices in the file
    """
    place: list[str | int] = []
    for part in location:
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            values = None
        place.append(values.source if isinstance(values, DrawnObject) else part)
    return tuple(place)


def drawn_item(values: Any, location: Location) -> int | None:
    """Return the number of the outermost object at a place among those of its entry.

    Parameters
    ----------
    values : mapping of the drawn scene
    location : keys and indices in the drawn scene

    Returns
    -------
    number of the object, counted from 0; None where there is no `count`
    """
    for part in location:
        try:
            values = values[part]
        except (KeyError, IndexError, TypeError):
            return None
        if isinstance(values, DrawnObject) and values.item is not None:
            return values.item
    return None


def numbers(seed: str, path: Path, count: int) -> Float[np.ndarray, " item"]:
    """Draw the numbers in [0, 1) of the first items under a key; more items do not change them.

    Parameters
    ----------
    seed : seed of the scene
    path : key
    count : number of items

    Returns
    -------
    one number per item
    """
    digest = sha256("\0".join((seed, *path)).encode()).digest()
    return np.random.Generator(np.random.Philox(key=np.frombuffer(digest[:16], np.uint64))).random(count)


@dataclass(frozen=True)
class _Draw:
    """One drawing of a scene."""

    seed: str
    refuse: Refuse

    def values(self, value: Any, path: Path, where: _Keys, count: int) -> list[Any]:
        """`count` drawings of a value with the key `path` that stands in the file at `where`."""
        if isinstance(value, dict):
            kind = None if where[-2:-1] == ("clip",) else _kind(value)  # the normal of a plane is none
            if kind == "choice":
                return self._choices(value, path, where, count)
            if kind is not None:
                return self._sample(kind, value, where, numbers(self.seed, path, count)).tolist()
            columns = [self.values(v, (*path, str(k)), (*where, k), count) for k, v in value.items()]
            return [dict(zip(value, row, strict=True)) for row in _rows(columns, count)]
        if isinstance(value, list):
            if where and where[-1] in _OBJECT_LISTS:
                return [self._objects(value, (*path, str(item)), where) for item in range(count)]
            columns = [self.values(v, (*path, str(i)), (*where, i), count) for i, v in enumerate(value)]
            return [list(row) for row in _rows(columns, count)]
        return [value] * count

    def _objects(self, entries: list[Any], path: Path, where: _Keys) -> list[Any]:
        """All objects of a list."""
        names = [entry["name"] for entry in entries if isinstance(entry, dict) and "name" in entry]
        found = []
        for i, entry in enumerate(entries):
            here = (*where, i)
            if not isinstance(entry, dict):
                found.append(entry)
                continue
            name = entry.get("name", str(i))
            if not isinstance(name, str) or names.count(name) > 1:
                raise self.refuse((*here, "name"), f"must be a text that no other object of the list has, got {name!r}")
            own = (*path, name)
            rules = {key: entry[key] for key in PLACE_KEYS if key in entry}
            rest = {key: value for key, value in entry.items() if key not in {"name", "count", *PLACE_KEYS}}
            items = self.values(rest, own, here, self._count(entry, own, here))
            if rules and items:
                drawn = self.values(rules, own, here, 1)[0]

                def chances(*key: str, own: Path = own, count: int = len(items)) -> Float[np.ndarray, " item"]:
                    return numbers(self.seed, (*own, *key), count)

                place(items, drawn, chances, lambda key, text, here=here: self.refuse((*here, *key), text))
            found += [DrawnObject(item, i, k if "count" in entry else None) for k, item in enumerate(items)]
        return found

    def _count(self, entry: dict[str, Any], path: Path, where: _Keys) -> int:
        """Return the number of objects of an entry."""
        count = self.values(entry.get("count", 1), (*path, "count"), (*where, "count"), 1)[0]
        if not isinstance(count, int) or isinstance(count, bool) or count < 0:
            hint = "; write such as {integers: [1, 9]}" if isinstance(count, dict) else ""
            raise self.refuse((*where, "count"), f"must be a whole number of objects, 0 or more, got {count!r}{hint}")
        if count > MOST_OBJECTS:
            raise self.refuse((*where, "count"), f"must be at most {MOST_OBJECTS}, got {shortened(count)}")
        return count

    def _choices(self, value: dict[str, Any], path: Path, where: _Keys, count: int) -> list[Any]:
        """One of some values each time; what stands beside `choice` belongs to all of them."""
        options, shared = value["choice"], {k: v for k, v in value.items() if k != "choice"}
        if not options:
            raise self.refuse((*where, "choice"), f"needs {DISTRIBUTIONS['choice']}, got []")
        if shared and not all(isinstance(option, dict) for option in options):
            raise self.refuse(
                (*where, "choice"), f"must hold mappings where other keys stand beside it: {list(shared)}"
            )
        inside = (*where, "choice")
        drawn = [self.values(o, (*path, "choice", str(i)), (*inside, i), count) for i, o in enumerate(options)]
        picked = (numbers(self.seed, (*path, "choice"), count) * len(options)).astype(int)
        found = [drawn[option][item] for item, option in enumerate(picked)]
        if not shared:
            return found
        return [{**rest, **own} for rest, own in zip(self.values(shared, path, where, count), found, strict=True)]

    def _sample(self, kind: str, value: dict[str, Any], where: _Keys, u: Float[np.ndarray, " item"]) -> np.ndarray:
        """Values of a distribution by inversion of its cumulative one."""
        known = {kind, "min", "max"} if kind == "normal" else {kind}
        for key in set(value) - known:
            raise self.refuse((*where, key), f"unknown key of {kind}")
        a, b = self._two(value[kind], kind, where)
        if kind == "uniform":
            return a + (b - a) * u
        if kind == "log_uniform":
            return np.exp(log(a) + (log(b) - log(a)) * u)
        if kind == "integers":
            return (a + np.floor((b - a + 1) * u)).astype(int)
        return self._normal(a, b, value, where, u)

    def _normal(
        self, mean: float, deviation: float, value: dict[str, Any], where: _Keys, u: Float[np.ndarray, " item"]
    ) -> Float[np.ndarray, " item"]:
        """A normal distribution, cut off at `min` and `max` where they are given."""
        from scipy.special import ndtr, ndtri  # noqa: PLC0415 - slow to import, seldom needed

        ends = (self._number(value.get(key, default)) for key, default in (("min", -np.inf), ("max", np.inf)))
        low, high = (None if end is None else (end - mean) / deviation for end in ends)
        if low is None or high is None or not ndtr(high) - ndtr(low) > 1e-12:
            raise self.refuse(where, "min and max of normal must be numbers with some of the distribution between them")
        return mean + deviation * np.clip(ndtri(ndtr(low) + (ndtr(high) - ndtr(low)) * u), low, high)

    def _two(self, given: list[Any], kind: str, where: _Keys) -> tuple[float, float]:
        """The two numbers of a distribution."""
        found = [self._number(x) for x in given]
        a, b = found if len(found) == 2 else (None, None)
        if a is not None and b is not None and np.isfinite([a, b]).all():
            right = {
                "uniform": a <= b,
                "log_uniform": 0 < a <= b,
                "normal": b > 0,
                "integers": a <= b and a.is_integer() and b.is_integer(),
            }[kind]
            if right:
                return a, b
        raise self.refuse((*where, kind), f"needs {DISTRIBUTIONS[kind]}, got {given}")

    @staticmethod
    def _number(value: Any) -> float | None:
        """A number, also one such as 1e-3 that YAML takes for a text."""
        try:
            return None if isinstance(value, bool) else float(value)
        except (TypeError, ValueError):
            return None


def _kind(value: dict[Any, Any]) -> str | None:
    """Name of the distribution that a mapping is, None where it is just a mapping."""
    return next((kind for kind in DISTRIBUTIONS if isinstance(value.get(kind), list)), None)


def _rows(columns: list[list[Any]], count: int) -> list[tuple[Any, ...]]:
    """Columns as rows; empty ones where there are no columns."""
    return list(zip(*columns, strict=True)) if columns else [()] * count
