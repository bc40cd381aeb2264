"""YAML text to plain values, within limits: no aliases without end, no deep nesting, no types but plain ones."""

from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import yaml

from spectra.errors import shortened

DEEPEST = 60  # lists and mappings in each other
MOST_VALUES = 2_000_000  # with aliases written out
MOST_CHARACTERS = 200_000_000
KEPT_CHARACTERS = 100_000  # texts up to this length are parsed once: a scene is asked for its values and its lines
_PLAIN = {f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str", "seq", "map", "merge")}


@dataclass(frozen=True)
class YamlText:
    """Parsed YAML.

    Parameters
    ----------
    root : the parsed text with line numbers; None for an empty text
    values : the same as dictionaries, lists, texts and numbers
    """

    root: yaml.Node | None
    values: Any


class YamlTextError(Exception):
    """What is wrong with a text, and where; for callers, who know whose text it is.

    Parameters
    ----------
    reason : what is wrong, without the place
    line, column : place in the text, counted from 1
    """

    def __init__(self, reason: str, line: int = 1, column: int = 1) -> None:
        super().__init__(reason)
        self.reason, self.line, self.column = reason, line, column


def parse_yaml(text: str) -> YamlText:
    """Parse YAML.

    Parameters
    ----------
    text : one document

    Returns
    -------
    nodes, which callers do not change, and values, which are theirs

    Raises
    ------
    YamlTextError
        When the text is no YAML, or has a type that a file of this project has no use for.
    """
    if len(text) > MOST_CHARACTERS:
        raise YamlTextError(f"the text has {len(text)} characters, at most {MOST_CHARACTERS} are read")
    if len(text) > KEPT_CHARACTERS:
        return _parsed(text)
    kept = _kept(text)
    return YamlText(kept.root, deepcopy(kept.values))


def _parsed(text: str) -> YamlText:
    """Parse a text that is not too long."""
    try:
        root = yaml.compose(text, Loader=yaml.SafeLoader)
        if root is not None and _size(root, {}, 1) > MOST_VALUES:
            raise YamlTextError(f"its aliases stand for more than {MOST_VALUES} values")
        return YamlText(root, yaml.safe_load(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = (mark.line + 1, mark.column + 1) if mark else (1, 1)
        raise YamlTextError(f"this is no YAML: {error.problem}", *place) from None
    except yaml.YAMLError as error:
        raise YamlTextError(str(error).splitlines()[0]) from None
    except RecursionError:
        raise YamlTextError(f"lists and mappings lie more than {DEEPEST} deep in each other") from None
    except (ValueError, TypeError, AttributeError, KeyError, OverflowError) as error:
        raise YamlTextError(f"a value cannot be read: {shortened(repr(error))}") from None


_kept = lru_cache(maxsize=16)(_parsed)


def _size(node: yaml.Node, known: dict[int, int], depth: int) -> int:
    """Values below a node, aliases written out; each node is looked at once."""
    if id(node) in known:
        if not known[id(node)]:
            raise _problem(node, "an alias stands inside of what it stands for")
        return known[id(node)]
    if node.tag not in _PLAIN:
        kind = node.tag.removeprefix("tag:yaml.org,2002:")
        hint = "put it in quotes" if kind == "timestamp" else "write numbers, texts, lists and mappings"
        raise _problem(node, f"a value of the type {kind!r} has no use here: {hint}")
    if depth > DEEPEST:
        raise _problem(node, f"lists and mappings lie more than {DEEPEST} deep in each other")
    known[id(node)] = 0
    below: list[yaml.Node] = []
    if isinstance(node, yaml.SequenceNode):
        below = node.value
    if isinstance(node, yaml.MappingNode):
        below = [part for pair in node.value for part in pair]
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise _problem(key, "a key must be a text or a number")
    total = 1 + sum(_size(part, known, depth + 1) for part in below)
    known[id(node)] = total
    return total


def _problem(node: yaml.Node, reason: str) -> YamlTextError:
    """A problem at the place of a node."""
    return YamlTextError(reason, node.start_mark.line + 1, node.start_mark.column + 1)
