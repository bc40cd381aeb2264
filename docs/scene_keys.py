"""Tables of all keys of a scene file, from the models that read it."""

import json
from collections.abc import Iterator
from typing import Any

from phantomgen.scene.schema import json_schema

_LIMITS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
_WORDS = {"number": "number", "integer": "integer", "boolean": "true or false", "string": "text"}


def scene_keys() -> str:
    """Markdown: a section for the scene, then for every model that it refers to, in the order of first reference."""
    schema = json_schema()
    sections = [_section("The file itself", schema)]
    for name in _in_order(schema):
        sections.append(_section(_title(name, schema["$defs"][name]), schema["$defs"][name]))
    return "\n\n".join(sections)


def kind(value: dict[str, Any]) -> str:
    """What a value may be, in words."""
    choices = value.get("anyOf") or value.get("oneOf")
    if choices:
        return " or ".join(dict.fromkeys(text for text in map(kind, choices) if text != "null"))
    if "$ref" in value:
        return f"[{_short(value['$ref'])}](#{anchor(value['$ref'])})"
    if "const" in value or "enum" in value:
        return " or ".join(f"`{choice}`" for choice in value.get("enum", [value.get("const")]))
    return _collection(value) if value.get("type") in {"array", "object"} else _plain(value)


def _collection(value: dict[str, Any]) -> str:
    if value["type"] == "object":
        inner = next(iter(value.get("patternProperties", {}).values()), value.get("additionalProperties"))
        return f"mapping of names to: {kind(inner)}" if isinstance(inner, dict) else "mapping"
    if "prefixItems" in value:
        return f"{len(value['prefixItems'])} of: {kind(value['prefixItems'][0])}"
    return f"list of: {kind(value['items'])}"


def _plain(value: dict[str, Any]) -> str:
    limits = [f"{sign} {value[key]:g}" for key, sign in _LIMITS.items() if key in value]
    return " ".join([_WORDS.get(value["type"], value["type"]), *limits])


def anchor(reference: str) -> str:
    """Label of the section of a model."""
    return "key-" + reference.rpartition("/")[2].removesuffix("Model").lower()


def _short(reference: str) -> str:
    name = reference.rpartition("/")[2].removesuffix("Model")
    return "".join(" " + letter.lower() if letter.isupper() else letter for letter in name).strip()


def _title(name: str, model: dict[str, Any]) -> str:
    tag = model.get("properties", {}).get("type", {})
    words = tag.get("enum") or ([tag["const"]] if "const" in tag else [])
    tags = ", ".join(f"`type: {word}`" for word in words)
    return f"{_short(name).capitalize()} ({tags})" if tags else _short(name).capitalize()


def _section(title: str, model: dict[str, Any]) -> str:
    rows = [
        f"| `{key}` | {kind(value)} | {_default(key, value, model)} |"
        for key, value in model.get("properties", {}).items()
    ]
    label = f"({anchor(model['title'])})=\n" if title != "The file itself" else ""
    text = model.get("description", "").strip()
    return f"{label}## {title}\n\n{text}\n\n| key | value | if left out |\n|---|---|---|\n" + "\n".join(rows)


def _default(key: str, value: dict[str, Any], model: dict[str, Any]) -> str:
    if key in model.get("required", ()):
        return "required"
    default = value.get("default")
    if default is None or isinstance(default, dict):
        return "off"
    return f"`{json.dumps(default)}`"


def _in_order(schema: dict[str, Any]) -> list[str]:
    found: dict[str, None] = {}
    waiting = list(_references(schema["properties"]))
    while waiting:
        name = waiting.pop(0)
        if name not in found:
            found[name] = None
            waiting += _references(schema["$defs"][name])
    return list(found)


def _references(value: Any) -> Iterator[str]:
    if isinstance(value, dict):
        if "$ref" in value:
            yield value["$ref"].rpartition("/")[2]
        for key, inner in value.items():
            if key != "discriminator":
                yield from _references(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from _references(inner)
