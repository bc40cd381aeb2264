"""The text of FORBILD phantom files: macros, expressions and blocks.

The syntax is that of the FORBILD group in Erlangen ("How to define a phantom"), which goes through the C preprocessor::

    #define SHELL(dens) formula=H2O rho=dens
    { "5" [Ellipsoid: y=-3.6 dx=9.6 dy=12 dz=12.5 x<9.1 r(1,1,0)>2/sqrt(2)] SHELL(1.8) }

Lengths are in cm, angles in degrees. A plane ``r(a,b,c) < d`` keeps what lies within the distance d of the origin along
the normal (a, b, c) of any length. Anything else is refused with its file, line and column.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import cos, radians, sin, sqrt, tan
from pathlib import Path

from phantomgen.importers.forbild_preprocessor import Token, read_words
from spectra.errors import SceneError

_FUNCTIONS = {
    "sin": lambda x: sin(radians(x)),
    "cos": lambda x: cos(radians(x)),
    "tan": lambda x: tan(radians(x)),
    "sqrt": sqrt,
}
_GERMAN = {"achse": "axis", "dichte": "rho", "formel": "formula"}
_PLANES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}

Vector = tuple[float, float, float]


@dataclass
class Block:
    """Object as it stands in the file.

    Parameters
    ----------
    kind, place, label : its type, where that stands, and the text in front of it
    values : numbers by name, as they stand in the file [cm]
    vectors : directions by name
    planes : normal and offset of planes below which the object is kept [cm]
    density, tissue, formula : `rho`, the macro that gave it, and `formula`, where they are given
    """

    kind: str
    place: str
    label: str = ""
    values: dict[str, float] = field(default_factory=dict)
    vectors: dict[str, Vector] = field(default_factory=dict)
    planes: list[tuple[Vector, float]] = field(default_factory=list)
    density: float | None = None
    tissue: str = ""
    formula: str = ""


def read_blocks(path: Path) -> list[Block]:
    """Read all objects of a file and of those that it includes, in their order.

    Parameters
    ----------
    path : the file

    Returns
    -------
    the objects

    Raises
    ------
    SceneError
        With file, line and column of what is not understood.
    """
    return list(_Parser(read_words(path), path.name).blocks())


class _Parser:
    """Reads blocks from words."""

    def __init__(self, tokens: list[Token], name: str) -> None:
        self.tokens = tokens
        self.at = 0
        self.end = Token("end", "the end of the file", tokens[-1].place if tokens else f"{name}:1:1")

    def peek(self, ahead: int = 0) -> Token:
        """A word that comes."""
        return self.tokens[self.at + ahead] if self.at + ahead < len(self.tokens) else self.end

    def take(self, *wanted: str) -> Token:
        """The next word, one of the texts or kinds that are wanted."""
        token = self.peek()
        if token.text not in wanted and token.kind not in wanted:
            raise SceneError(f"{token.place}: {' or '.join(wanted)} is expected here, got {token.text!r}")
        self.at += 1
        return token

    def blocks(self) -> Iterator[Block]:
        """All blocks; the words Phantom and Text say nothing about objects."""
        while self.peek().kind != "end":
            word = self.take("{", "Phantom", "Text")
            if word.text == "Text":
                self.take("string")
            elif word.text == "{":
                yield self.block()

    def block(self) -> Block:
        """A block behind its opening brace."""
        label = self.take("string").text.strip('"') if self.peek().kind == "string" else ""
        self.take("[")
        kind = self.take("name")
        self.take(":")
        block = Block(kind.text, kind.place, label)
        while self.peek().text != "]":
            self.entry(block)
        self.take("]")
        while self.peek().text != "}":
            self.property(block)
        self.take("}")
        return block

    def entry(self, block: Block) -> None:
        """A number, a direction or a plane."""
        word = self.take("name")
        name = _GERMAN.get(word.text, word.text)
        sign = self.peek()
        if name == "union":
            self.union()
        elif sign.text == "=":
            self.take("=")
            self.put(block.values, name, self.expression(), word)
        elif sign.text in "<>" and name in _PLANES:
            self.plane(block, _PLANES[name])
        elif sign.text == "(":
            vector = self.vector()
            if name == "r":
                self.plane(block, vector)
            else:
                self.put(block.vectors, name, vector, word)
        else:
            raise SceneError(f"{sign.place}: =, <, > or ( is expected behind {word.text!r}, got {sign.text!r}")

    def property(self, block: Block) -> None:
        """Density, formula or union, behind the shape."""
        word = self.take("name")
        name = _GERMAN.get(word.text, word.text)
        if name == "union":
            self.union()
            return
        self.take("=")
        if name == "rho":
            first = self.peek()
            block.density = self.expression()
            block.tissue = first.macro if self.tokens[self.at - 1] is first else ""
        elif name == "formula":
            block.formula = self.take("name").text
        else:
            raise SceneError(f"{word.place}: {word.text!r} is not understood: rho, formula and union are")

    def union(self) -> None:
        """``union=-1``, with an object of the same density: no change where later objects replace earlier ones."""
        self.take("=")
        self.expression()

    def plane(self, block: Block, normal: Vector) -> None:
        """Read the text behind the normal of a plane."""
        sign = 1.0 if self.take("<", ">").text == "<" else -1.0
        length = sqrt(sum(n * n for n in normal))
        if length == 0:
            raise SceneError(f"{self.peek().place}: the normal of a plane must not be zero")
        x, y, z = (sign * n / length for n in normal)
        block.planes.append(((x, y, z), sign * self.expression()))

    def put(self, values: dict, name: str, value: object, word: Token) -> None:
        """Note a value, once."""
        if name in values:
            raise SceneError(f"{word.place}: {name!r} stands twice in one object")
        values[name] = value

    def vector(self) -> Vector:
        """Three expressions in parentheses."""
        self.take("(")
        x = self.expression()
        self.take(",")
        y = self.expression()
        self.take(",")
        z = self.expression()
        self.take(")")
        return x, y, z

    def expression(self) -> float:
        """A sum of products."""
        value = self.product()
        while self.peek().text in ("+", "-"):
            sign = self.take("+", "-").text
            value += self.product() if sign == "+" else -self.product()
        return value

    def product(self) -> float:
        """A product of factors."""
        value = self.factor()
        while self.peek().text in ("*", "/"):
            mark = self.take("*", "/")
            other = self.factor()
            if mark.text == "/" and other == 0:
                raise SceneError(f"{mark.place}: division by zero")
            value = value * other if mark.text == "*" else value / other
        return value

    def factor(self) -> float:
        """A number, a function or a parenthesis, with signs."""
        token = self.take("number", "name", "-", "+", "(")
        if token.kind == "number":
            return float(token.text)
        if token.text in ("-", "+"):
            return self.factor() if token.text == "+" else -self.factor()
        if token.text != "(":
            if token.text not in _FUNCTIONS:
                raise SceneError(f"{token.place}: {token.text!r} is no number, and no macro defines it")
            self.take("(")
        value = self.expression()
        self.take(")")
        if token.text == "sqrt" and value < 0:
            raise SceneError(f"{token.place}: the root of {value:g} does not exist")
        return _FUNCTIONS[token.text](value) if token.text != "(" else value
