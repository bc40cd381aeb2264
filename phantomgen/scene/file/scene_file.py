"""Reading a scene file: YAML text to a checked model, every complaint with file, line, column and key."""

import difflib
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from copy import deepcopy
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel, ValidationError

from phantomgen.runtime.yaml_text import YamlText, YamlTextError, parse_yaml
from phantomgen.scene import schema
from phantomgen.scene.bodies.expand import BodyError, expanded
from phantomgen.scene.file.random_values import DISTRIBUTIONS, draw, drawn_item, source_place
from phantomgen.scene.schema import SceneModel
from spectra.errors import Error, SceneError, shortened

Location = tuple[str | int, ...]
Overrides = Sequence[str] | Mapping[str, Any]  # ``path=value``, or values by path
# More objects are written as one line of JSON each, which is YAML too: PyYAML takes half a millisecond for each.
_MANY = 1000


@dataclass(frozen=True)
class SceneFile:
    """Text of a scene, its origin, and the values that override it.

    Parameters
    ----------
    name : shown in messages
    text : YAML
    overrides : ``path=value`` with a dotted path, such as ``geometry.views=180`` or ``objects.0.radius=40``
    given : the mapping, where Python gives it in place of a text; messages then name no line
    """

    name: str
    text: str
    overrides: tuple[str, ...] = ()
    given: dict[str, Any] | None = field(default=None, hash=False)

    @classmethod
    def read(cls, path: Path | str, overrides: Sequence[str] = ()) -> "SceneFile":
        """Read a scene file.

        Parameters
        ----------
        path : the file
        overrides : ``path=value`` with dotted paths

        Returns
        -------
        the scene file

        Raises
        ------
        SceneError
            When the file cannot be read.
        """
        try:
            return cls(str(path), Path(path).read_text(encoding="utf-8"), tuple(overrides))
        except OSError as error:
            raise SceneError(f"{path} cannot be read as a scene: {error.strerror}") from None
        except UnicodeDecodeError:
            raise SceneError(f"{path} cannot be read as a scene: it is not UTF-8 text") from None

    @classmethod
    def preset(cls, name: str, overrides: Sequence[str] = ()) -> "SceneFile":
        """Read a scene that comes with this package.

        Parameters
        ----------
        name : name of the preset
        overrides : ``path=value`` with dotted paths

        Returns
        -------
        the scene file

        Raises
        ------
        SceneError
            When there is no such preset.
        """
        if name not in preset_names():
            raise SceneError(f"unknown preset {shortened(name)!r}{closest(name, preset_names())}")
        text = resources.files("phantomgen").joinpath("scene", "presets", f"{name}.yaml").read_text(encoding="utf-8")
        return cls(f"{name}.yaml", text, tuple(overrides))

    def changed(self, overrides: Overrides) -> "SceneFile":
        """Return the scene file with more values that override it.

        Parameters
        ----------
        overrides : values by dotted path, or texts ``path=value``

        Returns
        -------
        the scene file
        """
        return replace(self, overrides=(*self.overrides, *override_texts(overrides)))

    @cached_property
    def model(self) -> SceneModel:
        """The checked scene."""
        try:
            model = SceneModel.model_validate(self.values)
        except ValidationError as error:
            raise self.error(*_worst(error.errors())) from None
        return model

    @cached_property
    def values(self) -> dict[str, Any]:
        """The mapping in the file, with the overrides put in and all distributions drawn."""
        try:
            return expanded(draw(self.template, self._error_at))
        except BodyError as problem:
            raise self._error_at(*problem.of(_worst)) from None

    @cached_property
    def template(self) -> dict[str, Any]:
        """The mapping in the file, with the overrides put in."""
        if self.given is not None:
            values = deepcopy(self.given)
        elif isinstance(self._root, yaml.MappingNode):
            values = self._parsed.values
        else:
            raise SceneError(f"{self.name}:1:1: a scene is a mapping of keys to values that starts with 'version: 1'")
        for override in self.overrides:
            _override(values, override)
        return values

    @property
    def resolved(self) -> str:
        """The scene as YAML, overrides and defaults included."""
        return scene_text(self.model.model_dump(mode="json", exclude_none=True))

    def error(self, location: Location, message: str) -> SceneError:
        """Create an error that names the place of its cause in the file, or the override that caused it.

        Parameters
        ----------
        location : keys and indices in the drawn scene
        message : one sentence

        Returns
        -------
        the error
        """
        keys = _keys(self.values, location)
        item = drawn_item(self.values, keys)
        drawn = "" if item is None else f" (object {item} of those drawn)"
        return self._error_at(source_place(self.values, keys), message + drawn)

    def _error_at(self, location: Location, message: str) -> SceneError:
        """Create an error at a place in the file, where an entry may stand for many objects."""
        key = ".".join(map(str, location))
        paths = {override: override.partition("=")[0].strip() for override in self.overrides}
        for override, path in reversed(paths.items()):  # the last one of a path is in force
            if key == path or key.startswith(f"{path}."):
                return SceneError(f"--set {shortened(override)}: {key} - {message}")
        parts = [f"--set {override}" for override, path in paths.items() if key and path.startswith(f"{key}.")]
        where = f"{key} (with {', '.join(parts)})" if parts else key
        place = self.name if self.given is not None else f"{self.name}:{_mark(self._root, location)}"
        return SceneError(f"{place}: {where}{' - ' if where else ''}{message}")

    @contextmanager
    def at(self, *location: str | int) -> Iterator[None]:
        """Add the place in the file to errors of physics and geometry; a context manager.

        Parameters
        ----------
        *location : keys and indices in the drawn scene

        Yields
        ------
        nothing

        Raises
        ------
        SceneError
            With the place in the file.
        """
        try:
            yield
        except SceneError:
            raise
        except Error as error:
            raise self.error(location, str(error)) from None

    @cached_property
    def _root(self) -> yaml.Node | None:
        """The parsed file with line numbers."""
        root = self._parsed.root
        _refuse_repeats(root, self.name)
        return root

    @property
    def _parsed(self) -> YamlText:
        """The file as nodes and as values, which are new each time."""
        try:
            return parse_yaml(self.text)
        except YamlTextError as problem:
            raise SceneError(f"{self.name}:{problem.line}:{problem.column}: {problem.reason}") from None


def scene_text(data: dict[str, Any]) -> str:
    """Write the mapping of a scene as YAML.

    Parameters
    ----------
    data : keys of a scene file, with plain values

    Returns
    -------
    text of a scene file
    """
    if len(data["objects"]) <= _MANY:
        return _dump(data)
    lines = "".join(f"- {json.dumps(values)}\n" for values in data["objects"])
    keys = list(data)
    head, tail = keys[: keys.index("objects")], keys[keys.index("objects") + 1 :]
    rest = yaml.safe_dump({key: data[key] for key in tail}, sort_keys=False) if tail else ""
    return f"{_dump({key: data[key] for key in head})}objects:\n{lines}{rest}"


def override_texts(overrides: Overrides) -> tuple[str, ...]:
    """Return overrides as texts.

    Parameters
    ----------
    overrides : values by dotted path, or texts ``path=value``

    Returns
    -------
    texts ``path=value``
    """
    if isinstance(overrides, str):
        return (overrides,)
    if not isinstance(overrides, Mapping):
        return tuple(overrides)
    return tuple(f"{path}={_flow(path, value)}" for path, value in overrides.items())


def plain(value: Any) -> Any:
    """Return a value as YAML has it: mappings, lists, texts and numbers, in place of tuples and those of NumPy.

    Parameters
    ----------
    value : any value

    Returns
    -------
    the plain value; what is none is returned as it is
    """
    if isinstance(value, Mapping):
        return {plain(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    return plain(value.tolist()) if hasattr(value, "tolist") else value


def _flow(path: str, value: Any) -> str:
    """A value as YAML in one line."""
    try:
        text = yaml.safe_dump(plain(value), default_flow_style=True, width=float("inf"), sort_keys=False)
    except yaml.YAMLError:
        raise SceneError(f"{path}: write numbers, texts, lists or mappings, got {shortened(repr(value))}") from None
    return text.removesuffix("\n").removesuffix("\n...")


def preset_names() -> list[str]:
    """Return the names of the scenes that come with this package.

    Returns
    -------
    names in alphabetical order
    """
    files = resources.files("phantomgen").joinpath("scene", "presets").iterdir()
    return sorted(f.name.removesuffix(".yaml") for f in files if f.name.endswith(".yaml"))


def preset_summaries() -> dict[str, str]:
    """Return the first sentence of the comment that opens each preset.

    Returns
    -------
    sentences by name of the preset
    """
    comments = {}
    for name in preset_names():
        lines = [line[1:].strip() for line in SceneFile.preset(name).text.splitlines() if line.startswith("#")]
        comments[name] = " ".join(lines).partition(". ")[0].rstrip(".") + "."
    return comments


def closest(word: str, known: Iterable[str]) -> str:
    """Return a hint at the known word that is closest to a word, or at all known words.

    Parameters
    ----------
    word : the unknown word
    known : known words

    Returns
    -------
    end of a sentence
    """
    known = list(known)
    near = difflib.get_close_matches(word, known, 1)
    choice = f": choose from {', '.join(known)}" if known else ""
    return f"; did you mean {near[0]!r}?" if near else choice


def validation_sentence(error: ValidationError, kind: str, values: dict[str, Any]) -> str:
    """Return the key and the sentence of what is wrong in one object.

    Parameters
    ----------
    error : of the object's model
    kind : type of the object
    values : its keys

    Returns
    -------
    one sentence
    """
    found = [problem | {"loc": (kind, *problem["loc"])} for problem in error.errors()]
    location, sentence = _worst(found)
    return f"{'.'.join(map(str, _keys(values, location[1:])))} - {sentence}"


def _worst(errors: Iterable[Any]) -> tuple[Location, str]:
    """Place and sentence of the error that is nearest to the point."""
    found = min(errors, key=_rank)
    location = (*found["loc"], "type") if found["type"].startswith("union_tag") else found["loc"]
    return location, _sentence(found)


def _rank(error: Any) -> tuple[bool, bool]:
    """Order of errors: a misspelt key explains the rest, and a wrong value is nearer the point than a wrong type."""
    return error["type"] != "extra_forbidden", error["type"].endswith("_type")


def _sentence(error: Any) -> str:
    """Return the error that pydantic found as a sentence for the author of a scene."""
    kind, got = error["type"], error.get("input")
    if kind in {"missing", "union_tag_not_found"}:
        return f"is missing{_choices(str(error['loc'][-1]))}"
    if kind == "extra_forbidden":
        return f"unknown key{_hint(error['loc'])}"
    if kind == "union_tag_invalid":
        return f"unknown type {error['ctx']['tag']!r}: choose from {error['ctx']['expected_tags']}"
    if isinstance(got, dict) and len(got) == 1 and not kind.startswith("missing"):
        name = str(next(iter(got)))
        if name in DISTRIBUTIONS:
            return f"{name} needs {DISTRIBUTIONS[name]}, got {got[name]!r}"
        if isinstance(got[name], list):
            return f"unknown distribution {name!r}{closest(name, DISTRIBUTIONS)}"
    text = error["msg"].removeprefix("Value error, ")
    text = text[0].lower() + text[1:]
    if kind == "too_short":
        text = f"needs at least {error['ctx']['min_length']}, got {error['ctx']['actual_length']}"
    if kind in ("list_type", "tuple_type"):
        text = "needs a list"
    return f"{text}, got {shortened(repr(got))}" if isinstance(got, str | int | float | bool | None) else text


def _choices(key: str) -> str:
    """Return the allowed values of a key that has a choice of values."""
    for found in (model.model_fields[key] for model in _models() if key in model.model_fields):
        options = get_args(found.annotation) if get_origin(found.annotation) is Literal else ()
        if len(options) > 1:
            return f": choose from {', '.join(map(str, options))}"
    return ""


def _models() -> list[type[BaseModel]]:
    """All models of a scene file."""
    return [m for m in vars(schema).values() if isinstance(m, type) and issubclass(m, BaseModel)]


def _fields() -> set[str]:
    """All keys that a scene file may have somewhere."""
    return {name for model in _models() for name in model.model_fields}


def _hint(location: Location) -> str:
    """A hint at the key that is meant: of the section or type that is described there, with all keys, else of any."""
    key, place = str(location[-1]), location[-2] if len(location) > 1 else None
    owners = [m for m in _models() if "type" in m.model_fields and place in get_args(m.model_fields["type"].annotation)]
    owners = owners or list({m for m in _models() for f in _models() if _is_section(f, place, m)})
    if len(owners) == 1:
        hint, keys = closest(key, owners[0].model_fields), ", ".join(owners[0].model_fields)
        return f"{hint} (keys: {keys})" if "did you mean" in hint else hint
    near = difflib.get_close_matches(key, _fields() - {key}, 1)
    return f"; did you mean {near[0]!r}?" if near else ""


def _is_section(owner: type[BaseModel], name: Any, model: type[BaseModel]) -> bool:
    """Whether a model has a section of that name which another model describes, maybe an optional one."""
    field = owner.model_fields.get(name) if isinstance(name, str) else None
    return field is not None and (field.annotation is model or model in get_args(field.annotation))


def _override(values: dict[str, Any], override: str) -> None:
    """Put the value of ``path=value`` in its place."""
    path, equals, text = override.partition("=")
    if not equals or not path.strip():
        raise SceneError(f"--set {override}: write path=value, such as geometry.views=180")
    try:
        value = parse_yaml(text).values
    except YamlTextError:
        raise SceneError(f"--set {shortened(override)}: {shortened(text)!r} is not a YAML value") from None
    holder, rest = values, path.strip()
    while True:
        key, rest = _next_key(holder, rest, override)
        if not rest:
            holder[key] = value
            return
        holder = holder.setdefault(key, {}) if isinstance(holder, dict) else holder[key]


def _next_key(holder: Any, path: str, override: str) -> tuple[Any, str]:
    """First key of a dotted path and what follows it; a key that is there may hold dots itself.

    A key that a scene file may have, such as ``effects``, need not be there.
    """
    first, _, rest = path.partition(".")
    if isinstance(holder, list):
        if not first.isdigit() or int(first) >= len(holder):
            raise SceneError(f"--set {override}: {first!r} is no entry of a list of {len(holder)}, counted from 0")
        return int(first), rest
    if not isinstance(holder, dict):
        raise SceneError(f"--set {override}: there is no key {first!r} in a single value")
    known = [key for key in map(str, holder) if path == key or path.startswith(f"{key}.")]
    if known:
        key = max(known, key=len)
        return key, path[len(key) + 1 :]
    if rest and first not in _fields():
        raise SceneError(f"--set {override}: there is no {first!r}{closest(first, map(str, holder))}")
    return first, rest


def _dump(data: dict[str, Any]) -> str:
    """Values as YAML."""
    return yaml.safe_dump(data, sort_keys=False, default_flow_style=None, width=120)


def _keys(values: Any, location: Location) -> Location:
    """`location` without the tags of unions, which pydantic adds and the file does not have."""
    keys: list[str | int] = []
    for part in location:
        if isinstance(values, dict):
            if part not in values and (part == values.get("type") or not str(part).isidentifier()):
                continue
            values = values.get(part)
        elif isinstance(values, list | tuple) and isinstance(part, int):
            values = values[part] if part < len(values) else None
        else:
            continue
        keys.append(part)
    return tuple(keys)


def _mark(node: yaml.Node | None, location: Location) -> str:
    """``line:column`` of the deepest part of `location` that stands in the file, counted from 1."""
    deepest = node
    for part in location:
        if isinstance(node, yaml.MappingNode):
            value = next((v for k, v in node.value if k.value == str(part)), None)
            deepest = node = value or node
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
            deepest = node = node.value[part]
    return "1:1" if deepest is None else f"{deepest.start_mark.line + 1}:{deepest.start_mark.column + 1}"


def _refuse_repeats(node: yaml.Node | None, name: str) -> None:
    """Refuse a key that stands twice in one mapping; YAML would silently take the last one."""
    if isinstance(node, yaml.SequenceNode):
        for item in node.value:
            _refuse_repeats(item, name)
    if isinstance(node, yaml.MappingNode):
        seen = set()
        for key, value in node.value:
            if key.value in seen:
                place = f"{key.start_mark.line + 1}:{key.start_mark.column + 1}"
                raise SceneError(f"{name}:{place}: the key {key.value!r} stands twice in one mapping")
            seen.add(key.value)
            _refuse_repeats(value, name)
