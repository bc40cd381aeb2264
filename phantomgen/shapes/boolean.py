"""Boolean shapes: unions, intersections, differences, and shapes that are moved, turned or scaled."""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np
from jaxtyping import Float

from phantomgen.ops.primitives import HALFSPACE
from phantomgen.shapes.base import Part, Shape, Term, Triple, checked_axis
from spectra.errors import InputError

# Most terms that a combination of shapes may fall into: a bound of time.
_MOST_TERMS = 500


@dataclass(frozen=True)
class HalfSpace(Shape):
    """Half space below a plane, ``normal . x < offset``; it cuts other shapes and is not an object by itself.

    Parameters
    ----------
    normal : normal of the plane, any length, pointing away from what is kept
    offset : distance of the plane from the origin along the normal [mm]
    """

    normal: Triple
    offset: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", checked_axis("half-space", "normal", self.normal))
        if not np.isfinite(self.offset):
            raise InputError(f"half-space offset must be finite, got {self.offset!r}")

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term of one part."""
        local = np.zeros((3, 4))
        local[2, :3] = np.asarray(self.normal) / np.linalg.norm(self.normal)
        local[2, 3] = -self.offset
        return ((Part(HALFSPACE, local),),)


@dataclass(frozen=True)
class Union(Shape):
    """Union of shapes: points that lie in at least one of them.

    Parameters
    ----------
    shapes : the shapes
    """

    shapes: tuple[Shape, ...]

    @property
    def terms(self) -> tuple[Term, ...]:
        """All terms."""
        return tuple(term for shape in self.shapes for term in shape.terms)


@dataclass(frozen=True)
class Intersection(Shape):
    """Intersection of shapes: points that lie in all of them.

    Parameters
    ----------
    shapes : the shapes
    """

    shapes: tuple[Shape, ...]

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term for each choice of a term from every shape."""
        return _both(shape.terms for shape in self.shapes)


@dataclass(frozen=True)
class Difference(Shape):
    """Difference of shapes: points that lie in one shape and in none of the others.

    Parameters
    ----------
    base : the shape
    cut : shapes that are removed from it
    """

    base: Shape
    cut: tuple[Shape, ...]

    @property
    def terms(self) -> tuple[Term, ...]:
        """Terms of the base with, for each term that is cut off, a part that they lie outside."""
        return _both([self.base.terms, *(_outside(term) for shape in self.cut for term in shape.terms)])


@dataclass(frozen=True, eq=False)
class Placed(Shape):
    """Transformed shape: every point x of the original is at ``matrix @ x + offset``.

    Parameters
    ----------
    shape : the original
    matrix : (3, 3)
    offset : [mm]
    """

    shape: Shape
    matrix: Float[np.ndarray, "3 3"]
    offset: Float[np.ndarray, " 3"]

    def __post_init__(self) -> None:
        size = np.abs(self.matrix).max(initial=0.0)
        if not (np.isfinite(self.matrix).all() and np.isfinite(self.offset).all()):
            raise InputError("a transform must be finite")
        if size == 0 or abs(np.linalg.det(self.matrix / size)) < 1e-9:
            raise InputError("a transform must not flatten what it moves: its scale is zero along some direction")

    @property
    def terms(self) -> tuple[Term, ...]:
        """Moved terms."""
        return tuple(tuple(p.placed(self.matrix, self.offset) for p in term) for term in self.shape.terms)

    @property
    def volume(self) -> float | None:
        """Volume [mm^3]."""
        volume = self.shape.volume
        return None if volume is None else volume * abs(float(np.linalg.det(self.matrix)))


def _outside(term: Term) -> tuple[Term, ...]:
    """The complement of a term."""
    return tuple((part.opposite,) for part in term)


def _both(factors: Iterable[tuple[Term, ...]]) -> tuple[Term, ...]:
    """Terms of an intersection."""
    factors = list(factors)
    if np.prod([len(terms) for terms in factors], dtype=float) > _MOST_TERMS:
        raise InputError(
            f"a combination of shapes falls into more than {_MOST_TERMS} pieces: use fewer or simpler ones"
        )
    return tuple(tuple(part for term in choice for part in term) for choice in product(*factors))
