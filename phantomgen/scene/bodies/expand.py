"""Bodies in the mapping of a scene become groups of plain objects, and their materials join those of the scene.

The scene that a dataset stores therefore has plain objects only. A material of the scene with the name of one of a body
takes its place.
"""

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any

from pydantic import ValidationError

from phantomgen.scene.schema.bodies import BodyModel, HeadModel, TorsoModel
from spectra.errors import InputError

Location = tuple[str | int, ...]
Explain = Callable[[Iterable[Any]], tuple[Location, str]]

# The function that builds a body has the name of its module.
_BODIES: Mapping[str, type[BodyModel]] = {"torso": TorsoModel, "head": HeadModel}
# Keys that a body shares with a group.
_PLACED = ("center", "rotation", "clip", "repeat", "motion")


class BodyError(Exception):
    """A body that is impossible.

    Parameters
    ----------
    where : its place in the scene
    problem : what is wrong with its keys
    """

    def __init__(self, where: Location, problem: ValidationError | InputError) -> None:
        super().__init__(str(problem))
        self.where, self.problem = where, problem

    def of(self, explain: Explain) -> tuple[Location, str]:
        """Return place and sentence.

        Parameters
        ----------
        explain : picks place and sentence of what a model found wrong

        Returns
        -------
        place in the scene and sentence
        """
        if isinstance(self.problem, InputError):
            return self.where, str(self.problem)
        location, sentence = explain(self.problem.errors())
        return (*self.where, *location), sentence


def expanded(values: dict[str, Any]) -> dict[str, Any]:
    """Replace bodies by their objects.

    Parameters
    ----------
    values : mapping of a scene file

    Returns
    -------
    the scene with groups in place of bodies; `values` itself where there is no body

    Raises
    ------
    BodyError
        Where a key of a body is wrong.
    """
    objects = values.get("objects")
    if not isinstance(objects, list) or not any(map(_has_body, objects)):
        return values
    materials: dict[str, Any] = {}
    groups = [_replaced(item, ("objects", i), materials) for i, item in enumerate(objects)]
    own = values.get("materials") or {}
    all_materials = {**materials, **own} if isinstance(own, dict) else own  # which is refused later
    return {**values, "materials": all_materials, "objects": groups}


def _has_body(item: Any) -> bool:
    """Whether an object is a body or a group with one."""
    if not isinstance(item, dict):
        return False
    kind, members = item.get("type"), item.get("objects")
    if isinstance(kind, str) and kind in _BODIES:
        return True
    return isinstance(members, list) and any(map(_has_body, members))


def _replaced(item: Any, where: Location, materials: dict[str, Any]) -> Any:
    """A group in place of a body; `materials` gets its materials."""
    if not _has_body(item):
        return item
    kind = item.get("type")
    if not (isinstance(kind, str) and kind in _BODIES):
        members = [_replaced(one, (*where, "objects", i), materials) for i, one in enumerate(item["objects"])]
        return _like(item, {**item, "objects": members})
    build = getattr(import_module(f"phantomgen.scene.bodies.{kind}"), kind)  # only where a scene has a body
    try:
        model = _BODIES[kind].model_validate(dict(item))
        if model.material is not None:
            raise InputError("a body has tissues, and no material of its own")
        objects, needed, scale = build(model)
    except (ValidationError, InputError) as problem:
        raise BodyError(where, problem) from None
    materials |= needed
    group = {"type": "group", "scale": scale, "objects": objects}
    return _like(item, group | {key: item[key] for key in _PLACED if key in item})


def _like(item: dict[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """The values, as the same kind of mapping, which may know where it was drawn from."""
    if type(item) is dict:
        return values
    other = item.__class__.__new__(item.__class__)
    other.update(values)
    vars(other).update(vars(item))
    return other
