"""The words of FORBILD phantom files, which go through the C preprocessor: comments, includes and macros."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from spectra.errors import SceneError

_TOKEN = re.compile(
    r"(?P<space>\s+|\\\n)|(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r'|(?P<string>"[^"\n]*")|(?P<mark>[{}\[\]():=<>,+\-*/])'
)
_COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.DOTALL)
# Files may include each other so deep; deeper, they do so without end.
_DEEPEST = 20


@dataclass(frozen=True)
class Token:
    """Word of the text.

    Parameters
    ----------
    kind : kind of word
    text : the word
    place : file, line and column
    macro : macro without arguments that the word is the value of; empty if none
    """

    kind: str
    text: str
    place: str
    macro: str = ""


@dataclass(frozen=True)
class Macro:
    """Replacement of a name.

    Parameters
    ----------
    parameters : names of the arguments; None for a name without parentheses
    body : words that replace it
    """

    parameters: tuple[str, ...] | None
    body: tuple[Token, ...]


def read_words(path: Path) -> list[Token]:
    """Read all words of a file and of those that it includes, with macros replaced.

    Parameters
    ----------
    path : the file

    Returns
    -------
    the words

    Raises
    ------
    SceneError
        With file, line and column of what is not understood.
    """
    return list(_tokens(path, {}, 0))


def _tokens(path: Path, macros: dict[str, Macro], depth: int) -> Iterator[Token]:
    """Words of a file, macros replaced, includes in their place."""
    if depth > _DEEPEST:
        raise SceneError(f"{path.name}: files include each other more than {_DEEPEST} deep")
    try:
        text = path.read_text(encoding="latin-1")
    except OSError as error:
        raise SceneError(f"{path} cannot be read as a FORBILD phantom: {error.strerror}") from None
    text = _COMMENT.sub(lambda found: re.sub(r"[^\n]", " ", found.group()), text)
    pending: list[Token] = []
    number = 0
    lines = text.split("\n")
    while number < len(lines):
        first = number
        logical = lines[number]
        if not logical.lstrip().startswith("#"):
            pending += _words(logical, path.name, number + 1)
            number += 1
            continue
        while logical.endswith("\\") and number + 1 < len(lines):
            number += 1
            logical += "\n" + lines[number]
        number += 1
        yield from _expanded(pending, macros)
        pending = []
        included = _directive(logical, f"{path.name}:{first + 1}:1", path.name, first + 1, macros)
        if included is not None:
            yield from _tokens(path.parent / included, macros, depth + 1)
    yield from _expanded(pending, macros)


def _directive(line: str, place: str, name: str, number: int, macros: dict[str, Macro]) -> str | None:
    """Note a macro, or say which file is included; line markers of a preprocessor mean nothing."""
    if re.fullmatch(r'\s*#\s*(line\s+)?\d+\s+".*"[\s\d]*', line):
        return None
    include = re.fullmatch(r'\s*#\s*include\s+"([^"]+)"\s*', line)
    if include:
        return include.group(1)
    define = re.match(r"\s*#\s*define\s+([A-Za-z_]\w*)(\(([^)]*)\))?", line)
    if not define:
        raise SceneError(f'{place}: {line.strip()!r} is not understood: only #define and #include "file" are')
    body = tuple(_words(line, name, number, define.end()))
    parameters = None if define.group(2) is None else tuple(word.strip() for word in define.group(3).split(","))
    macros[define.group(1)] = Macro(parameters, body)
    return None


def _words(line: str, name: str, number: int, start: int = 0) -> Iterator[Token]:
    """Words of a line; it may hold continuations."""
    at = start
    while at < len(line):
        found = _TOKEN.match(line, at)
        before = line[:at]
        place = f"{name}:{number + before.count(chr(10))}:{at - before.rfind(chr(10))}"
        if found is None:
            raise SceneError(f"{place}: {line[at]!r} is not understood")
        at = found.end()
        if found.lastgroup != "space":
            yield Token(str(found.lastgroup), found.group(), place)


def _expanded(
    tokens: Sequence[Token], macros: dict[str, Macro], hidden: frozenset[str] = frozenset()
) -> Iterator[Token]:
    """Words with all macros replaced; they keep the place where the macro was used."""
    i = 0
    while i < len(tokens):
        token = tokens[i]
        macro = macros.get(token.text) if token.kind == "name" and token.text not in hidden else None
        i += 1
        if macro is None:
            yield token
            continue
        arguments: dict[str, list[Token]] = {}
        if macro.parameters is not None:
            arguments, i = _arguments(tokens, i, token, macro.parameters)
        value_of = token.text if macro.parameters is None else ""
        body: list[Token] = []
        for word in macro.body:
            body += arguments.get(word.text, [replace(word, place=token.place, macro=value_of)])
        yield from _expanded(body, macros, hidden | {token.text})


def _arguments(
    tokens: Sequence[Token], i: int, call: Token, parameters: tuple[str, ...]
) -> tuple[dict[str, list[Token]], int]:
    """Return the words between the parentheses of a macro, by parameter, and the position behind them."""
    found: list[list[Token]] = [[]]
    depth = 0
    for end in range(i, len(tokens)):
        text = tokens[end].text
        depth += (text == "(") - (text == ")")
        if depth == 0:
            break
        if text == "," and depth == 1:
            found.append([])
        elif not (text == "(" and depth == 1 and end == i):
            found[-1].append(tokens[end])
    else:
        end = len(tokens)
    if depth != 0 or end == i or end == len(tokens) or len(found) != len(parameters):
        raise SceneError(f"{call.place}: the macro {call.text} needs {len(parameters)} arguments in parentheses")
    return dict(zip(parameters, found, strict=True)), end + 1
