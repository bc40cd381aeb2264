"""Objects whose coefficients add up where they overlap, turned into objects that override each other.

Every set of objects with a common interior becomes one object, their intersection, with the sum of their coefficients;
larger sets come later and override smaller ones. So whatever reads a scene knows one rule of overlap only.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from jaxtyping import Bool

from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.shapes import Intersection, Shape
from spectra.errors import InputError
from spectra.materials.material import Material

# Most different sets of objects that overlap somewhere: a bound of time and memory.
_MOST_REGIONS = 2000
# Coefficients of a file are decimal numbers: what their sums have beyond this many digits is rounding.
_DIGITS = 12

Objects = Sequence[tuple[Shape, str | tuple[str, ...]]]
Region = frozenset[int]


def added_up(file: SceneFile, objects: Objects) -> tuple[list[tuple[Shape, str]], dict[str, Material]]:
    """Convert the objects of a scene with ``overlap: add`` to objects that override each other.

    Parameters
    ----------
    file : the scene, for its materials and for messages
    objects : shapes with the names of their materials

    Returns
    -------
    shapes with the names of their materials, and these materials by name

    Raises
    ------
    SceneError
        Where a material has no coefficients, where a sum is negative, or where too many objects overlap each other.
    """
    if file.model.background is not None:
        raise file.error(
            ("background",), "'overlap: add' knows no background: let the first object be a box around all"
        )
    contents = [_one_material(file, content) for _, content in objects]
    values = {name: _coefficients(file, name) for name in contents}
    arrangement = Arrangement(tuple(shape for shape, _ in objects))
    with file.at("overlap"):
        regions = arrangement.regions()
    found: list[tuple[Shape, str]] = []
    names: dict[tuple[tuple[str, float], ...], str] = {}
    for region in regions:
        members = [contents[i] for i in sorted(region)]
        total, label = _sum(values[name] for name in members), _label(members)
        for function, value in total:
            if value < 0:
                what = f"{label!r} add up to a {function} coefficient of {value:g} 1/mm"
                raise file.error(("overlap",), f"{what} where they overlap: sums must not be negative")
        found.append((arrangement.common(region), names.setdefault(total, label)))
    return found, {name: Material(name, coefficients=dict(total)) for total, name in names.items()}


@dataclass(frozen=True)
class Arrangement:
    """Shapes, with the relations which of them enclose each other and which intersect.

    Parameters
    ----------
    shapes : the shapes
    """

    shapes: tuple[Shape, ...]

    def regions(self) -> list[Region]:
        """Return the sets of shapes with a common interior, small ones first.

        A set holds all shapes that enclose one of its members: nothing lies in a member and outside of those.

        Returns
        -------
        sets of indices

        Raises
        ------
        InputError
            When too many shapes overlap.
        """
        closed = [frozenset([i, *np.flatnonzero(self._enclosed[:, i]).tolist()]) for i in range(len(self.shapes))]
        found: dict[Region, None] = {}
        for own in closed:
            wider = {region | own for region in found if not own <= region}
            found.update(
                dict.fromkeys([own, *(r for r in sorted(wider, key=sorted) if r not in found and self._meet(r))])
            )
            if len(found) > _MOST_REGIONS:
                raise InputError(f"objects overlap in more than {_MOST_REGIONS} ways: have fewer of them, or 'replace'")
        return sorted(found, key=len)

    def common(self, region: Region) -> Shape:
        """Return the intersection of some shapes.

        Parameters
        ----------
        region : indices of the shapes

        Returns
        -------
        the intersection
        """
        inner = self._innermost(region)
        return self.shapes[inner[0]] if len(inner) == 1 else Intersection(tuple(self.shapes[i] for i in inner))

    def _innermost(self, region: Region) -> list[int]:
        """Members that enclose no other one; of equal ones the last."""
        return [
            i
            for i in sorted(region)
            if not any(self._enclosed[i, k] and (k > i or not self._enclosed[k, i]) for k in region if k != i)
        ]

    def _meet(self, region: Region) -> bool:
        """Return whether all members have a common interior."""
        from phantomgen.shapes.intersection_tests import meet  # noqa: PLC0415 - scipy's optimizers only where objects add up

        inner = self._innermost(region)
        if not all(self._boxes_meet[i, k] for i, k in combinations(inner, 2)):
            return False
        return meet([self.shapes[i] for i in inner])

    @cached_property
    def _boxes_meet(self) -> Bool[np.ndarray, "shape shape"]:
        """Whose bounds overlap."""
        low, high = (np.array(corners) for corners in zip(*(shape.bounds for shape in self.shapes), strict=True))
        return np.all((low[:, None] < high[None]) & (low[None] < high[:, None]), axis=2)

    @cached_property
    def _enclosed(self) -> Bool[np.ndarray, "outer inner"]:
        """Matrix that is True where one shape certainly encloses another one."""
        from phantomgen.shapes.intersection_tests import encloses  # noqa: PLC0415

        found = np.zeros_like(self._boxes_meet)
        for i, k in np.argwhere(self._boxes_meet):
            found[i, k] = i != k and encloses(self.shapes[i], self.shapes[k])
        return found


def _one_material(file: SceneFile, content: str | tuple[str, ...]) -> str:
    """Name of the material of an object that has just one."""
    if isinstance(content, str):
        return content
    raise file.error(("overlap",), "a voxel map, of several materials, cannot be added to: write 'replace'")


def _coefficients(file: SceneFile, name: str) -> Mapping[str, float]:
    """Return the coefficients that an object of this material adds."""
    model = file.model.materials.get(name)
    coefficients = None if model is None else model.coefficients
    if coefficients is None:
        raise file.error(
            ("materials", name) if model else ("overlap",),
            f"'overlap: add' sums coefficients, so material {name!r} needs coefficients",
        )
    return coefficients


def _sum(parts: Iterable[Mapping[str, float]]) -> tuple[tuple[str, float], ...]:
    """Coefficients by function name [1/mm], in the order of the names."""
    total: dict[str, float] = {}
    for part in parts:
        for function, value in part.items():
            total[function] = total.get(function, 0.0) + value
    return tuple((function, round(value, _DIGITS) + 0.0) for function, value in sorted(total.items()))


def _label(members: Sequence[str]) -> str:
    """A name for a sum, such as ``skull + 2 lesion``."""
    return " + ".join(name if count == 1 else f"{count} {name}" for name, count in Counter(members).items())
