"""Nodes that average over a unit square cut by conics.

The square is [-1/2, 1/2]^2 in (a, b). One coordinate is outer: it is split where a conic passes the border, turns back,
or meets another one. For each outer node the inner coordinate is split at all roots. Between two splits the integrand
is smooth up to square roots at tangents; substituting the root's own variable (a = root + s^2, or a sine between two of
them) leaves a smooth function even where the tangent lies outside the square, and few Gauss nodes do.
"""

from functools import lru_cache
from math import asin, cos, gcd, isnan, nan, sin, sqrt
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int64
from numba import njit

from phantomgen.ops.kernel_decorators import called, inlined

# Most conics per square that are split exactly, which bounds memory; a square with more is sampled on a regular grid of
# `GRID` x `GRID` rays.
CONICS = 8
GRID = 16
# Kinds of pieces in `Rules`.
INNER, ARC, OUTER, ENDED, BOTH = 0, 1, 2, 3, 4
# Rows of the lines in `Room`.
_SPLITS, _CUTS, _TANGENTS = 0, 1, 2
# Side of the square; a tangent farther away than this needs no substitution, as a Gauss rule of two nodes integrates a
# square root there to 1e-6.
_FAR = 4.0
# Side of the square; pieces narrower than these are rounding, their parts of an average are below it.
_NARROWEST_PIECE, _NARROWEST_LINE = 1e-9, 1e-12
# Golden ratio less 1, no unit.
_GOLDEN_RATIO = 0.6180339887498949
# Bound on the rounding of a form's value, no unit, relative to the sum of its terms' sizes: some times 1e-16.
_ROUNDING = 4e-15


class Rules(NamedTuple):
    """Gauss rules of growing strength.

    Each level holds nodes and weights on [0, 1] for five kinds of pieces: `INNER`, the inner coordinate of a smooth
    piece; `ARC`, the same between two tangents; `OUTER`, the outer one; `ENDED` and `BOTH`, the same with one singular
    end and with two.

    Parameters
    ----------
    nodes : nodes and weights of each level and kind
    sizes : number of nodes
    """

    nodes: Float[np.ndarray, "level 5 2 node"]
    sizes: Int64[np.ndarray, "level 5"]


class Room(NamedTuple):
    """Scratch memory of `square_nodes`.

    Parameters
    ----------
    local : conics of the square: a, b, c, d, e, f, rounding error of a, 1 for a tangent and 0 for a kink
    lines : splits of the outer coordinate, cuts of the inner one, tangents
    nodes : (a, b, weight, part) of each node; nodes of a square in the same part have no conic between them
    """

    local: Float[np.ndarray, "conic 8"]
    lines: Float[np.ndarray, "3 cut"]
    nodes: Float[np.ndarray, "node 4"]


def gauss(n: int) -> Float[np.ndarray, "2 node"]:
    """Compute Gauss-Legendre nodes and weights on [0, 1].

    Parameters
    ----------
    n : number of nodes

    Returns
    -------
    nodes and weights
    """
    x, w = np.polynomial.legendre.leggauss(n)
    return np.stack([(x + 1) / 2, w / 2])


@lru_cache
def make_rules(*strengths: tuple[int, int]) -> Rules:
    """Create rules, with more nodes where both ends of a piece are singular.

    Parameters
    ----------
    *strengths : nodes across and along a conic, of each level

    Returns
    -------
    the rules
    """
    sizes = np.array([(inner, inner + 2, outer, outer + 1, outer + 3) for inner, outer in strengths], dtype=np.int64)
    nodes = np.zeros((*sizes.shape, 2, sizes.max()))
    for piece in np.ndindex(sizes.shape):
        nodes[piece][:, : sizes[piece]] = gauss(int(sizes[piece]))
    return Rules(nodes, sizes)


def make_room(rules: Rules) -> Room:
    """Allocate scratch memory of `square_nodes`, with nodes for three squares of the worst kind.

    Parameters
    ----------
    rules : the rules

    Returns
    -------
    arrays without values
    """
    splits = 6 * CONICS + CONICS * CONICS + 2
    lines = (splits + 1) * int(rules.sizes[:, BOTH].max())
    size = max(lines * (2 * CONICS + 1) * int(rules.sizes[:, ARC].max()), GRID * GRID)
    return Room(np.empty((CONICS + 1, 8)), np.empty((3, splits)), np.empty((3 * size, 4)))


@inlined
@no_type_check
def shift_form(forms, f, u, v, local, i):
    """Write a form relative to a point, with the rounding error of its value there.

    Parameters
    ----------
    forms, f : forms of a view, and the number of one
    u, v : the point
    local, i : conics as in `Room`, and the row that is written
    """
    k0, ku, kv, kuu, kuv, kvv = forms[f, 0], forms[f, 1], forms[f, 2], forms[f, 3], forms[f, 4], forms[f, 5]
    local[i, 0] = k0 + u * (ku + kuu * u + kuv * v) + v * (kv + kvv * v)
    local[i, 1] = ku + 2.0 * kuu * u + kuv * v
    local[i, 2] = kv + 2.0 * kvv * v + kuv * u
    local[i, 3], local[i, 4], local[i, 5] = kuu, kuv, kvv
    size = abs(k0) + abs(u) * (abs(ku) + abs(kuu * u) + abs(kuv * v)) + abs(v) * (abs(kv) + abs(kvv * v))
    local[i, 6] = _ROUNDING * size


@inlined
@no_type_check
def may_vanish(local, i):
    """Return whether a local form can be zero inside the unit square.

    Parameters
    ----------
    local, i : conics as in `Room`, and the row of one

    Returns
    -------
    False only where it certainly has no zero
    """
    slope = abs(local[i, 1]) + abs(local[i, 2])
    bend = abs(local[i, 3]) + abs(local[i, 4]) + abs(local[i, 5])
    return abs(local[i, 0]) <= 0.5 * slope + 0.25 * bend + local[i, 6]


@inlined
@no_type_check
def quadratic_roots(c2, c1, c0, error):
    """Compute the real roots of ``c2 x^2 + c1 x + c0``.

    Parameters
    ----------
    c2, c1, c0 : coefficients
    error : of c0; a double root that may be missing because of it counts

    Returns
    -------
    two roots, NaN for missing ones
    """
    discriminant = c1 * c1 - 4.0 * c2 * c0
    if discriminant < 0.0:
        if discriminant < -4.0 * abs(c2) * error:
            return nan, nan
        discriminant = 0.0
    larger = -0.5 * (c1 + sqrt(discriminant)) if c1 >= 0.0 else -0.5 * (c1 - sqrt(discriminant))
    first = larger / c2 if c2 != 0.0 else nan
    return first, c0 / larger if larger != 0.0 else first


@inlined
@no_type_check
def _add_inside(lines, row, count, value):
    """Insert a value into the ascending first `count` of a row if it lies inside the square; return the new count."""
    if not -0.5 < value < 0.5:
        return count
    at = count
    while at > 0 and lines[row, at - 1] > value:
        lines[row, at] = lines[row, at - 1]
        at -= 1
    lines[row, at] = value
    return count + 1


@inlined
@no_type_check
def _meeting_point(local, i, j):
    """Outer coordinate where two conics meet in the square, by Newton's method from its centre; NaN if none."""
    a = b = 0.0
    for _ in range(8):
        f, fa, fb = _value_and_slopes(local, i, a, b)
        g, ga, gb = _value_and_slopes(local, j, a, b)
        det = fa * gb - fb * ga
        if abs(det) <= 1e-9 * (abs(fa) + abs(fb)) * (abs(ga) + abs(gb)):
            return nan
        da, db = (f * gb - g * fb) / det, (g * fa - f * ga) / det
        a, b = a - da, b - db
        if not (abs(a) < 2.0 and abs(b) < 2.0):
            return nan
        if abs(da) + abs(db) < 1e-9:
            return b if abs(a) < 0.5 else nan
    return nan


@inlined
@no_type_check
def _value_and_slopes(local, i, a, b):
    """Value and both derivatives of a conic."""
    value = local[i, 0] + a * (local[i, 1] + local[i, 3] * a + local[i, 4] * b) + b * (local[i, 2] + local[i, 5] * b)
    slope_a = local[i, 1] + 2.0 * local[i, 3] * a + local[i, 4] * b
    return value, slope_a, local[i, 2] + 2.0 * local[i, 5] * b + local[i, 4] * a


@inlined
@no_type_check
def _outer_splits(local, count, lines):
    """Ascending outer coordinates inside the square where the inner integral is not smooth; return how many."""
    found = np.int64(0)
    for i in range(count):
        a, b, c = local[i, 0], local[i, 1], local[i, 2]
        d, e, f = local[i, 3], local[i, 4], local[i, 5]
        for k in range(3):
            # Left border, right border, and where the discriminant over the inner coordinate vanishes.
            side = k - 0.5
            if k < 2:
                first, second = quadratic_roots(f, c + e * side, a + side * (b + d * side), local[i, 6])
            else:
                first, second = quadratic_roots(
                    e * e - 4.0 * d * f, 2.0 * b * e - 4.0 * d * c, b * b - 4.0 * d * a, 0.0
                )
            found = _add_inside(lines, _SPLITS, found, first)
            found = _add_inside(lines, _SPLITS, found, second)
        for j in range(i):
            found = _add_inside(lines, _SPLITS, found, _meeting_point(local, i, j))
    return found


@inlined
@no_type_check
def _orient(local, count):
    """Swap the coordinates of all conics if most of them run along the inner one; return whether that was done."""
    vote = 0.0
    for i in range(count):
        across, along = local[i, 1] * local[i, 1], local[i, 2] * local[i, 2]
        vote += (across - along) / (across + along + 1e-300)
    if vote >= 0.0:
        return False
    for i in range(count):
        local[i, 1], local[i, 2] = local[i, 2], local[i, 1]
        local[i, 3], local[i, 5] = local[i, 5], local[i, 3]
    return True


@inlined
@no_type_check
def _substitution(low, high, left, right):
    """Kind of substitution for one smooth piece, the tangent (or middle) it starts from, first value and span of s.

    `left` and `right` are the nearest tangents beyond the ends, NaN for none. Kinds: 0 a = s, 1 a = base + s^2,
    2 a = base - s^2, 3 a = base + half sin s; the last value returned is `half`.
    """
    if not isnan(left) and not isnan(right):
        middle, half = 0.5 * (left + right), 0.5 * (right - left)
        first = asin(max(-1.0, (low - middle) / half))
        return 3, middle, first, asin(min(1.0, (high - middle) / half)) - first, half
    if not isnan(left):
        first = sqrt(low - left)
        return 1, left, first, sqrt(high - left) - first, 0.0
    if not isnan(right):
        first = sqrt(right - high)
        return 2, right, first, sqrt(right - low) - first, 0.0
    return 0, 0.0, low, high - low, 0.0


@inlined
@no_type_check
def _substituted(kind, base, half, s):
    """Coordinate and its derivative at s."""
    if kind == 3:
        return base + half * sin(s), half * cos(s)
    if kind == 1:
        return base + s * s, 2.0 * s
    if kind == 2:
        return base - s * s, 2.0 * s
    return s, 1.0


@inlined
@no_type_check
def _nearest_tangents(lines, tangents, low, high):
    """Nearest tangents at or beyond both ends of a piece, NaN for none."""
    left = right = nan
    for j in range(tangents):
        root = lines[_TANGENTS, j]
        if root <= low and not root < left:
            left = root
        elif root >= high and not root > right:
            right = root
    return left, right


@inlined
@no_type_check
def _cut_inner(local, conics, lines, b):
    """Cut the inner coordinate at all roots for the outer coordinate `b`; return the numbers of cuts and tangents."""
    lines[_CUTS, 0] = -0.5
    cuts, tangents = np.int64(1), np.int64(0)
    for i in range(conics):
        c1, c0 = local[i, 1] + local[i, 4] * b, local[i, 0] + b * (local[i, 2] + local[i, 5] * b)
        first, second = quadratic_roots(local[i, 3], c1, c0, local[i, 6])
        for k in range(2):
            root = second if k else first
            cuts = _add_inside(lines, _CUTS, cuts, root)
            if local[i, 7] > 0.0 and abs(root) < _FAR:
                lines[_TANGENTS, tangents] = root
                tangents += 1
    lines[_CUTS, cuts] = 0.5
    return cuts, tangents


@inlined
@no_type_check
def _add_line(local, conics, rules, lines, nodes, at, line):
    """Write the nodes of a line along the inner coordinate, from index `at` on; return the next index.

    `rules` are nodes and sizes of one level, `line` the outer coordinate, the weight, and the number of the part that
    the line begins in.
    """
    rule_nodes, rule_sizes = rules
    b, weight, part = line
    cuts, tangents = _cut_inner(local, conics, lines, b)
    for i in range(cuts):
        low, high = lines[_CUTS, i], lines[_CUTS, i + 1]
        if high - low < _NARROWEST_LINE:
            continue
        left, right = _nearest_tangents(lines, tangents, low, high)
        kind, base, first, span, half = _substitution(low, high, left, right)
        rule = ARC if kind == 3 else INNER
        for k in range(rule_sizes[rule]):
            a, slope = _substituted(kind, base, half, first + span * rule_nodes[rule, 0, k])
            nodes[at, 0], nodes[at, 1] = a, b
            nodes[at, 2] = weight * slope * span * rule_nodes[rule, 1, k]
            nodes[at, 3] = part + i
            at += 1
    return at


@inlined
@no_type_check
def _end_map(x, from_split, to_split):
    """Position in [0, 1] and its slope, with nodes drawn to the ends that are splits."""
    if from_split and to_split:
        return x * x * (3.0 - 2.0 * x), 6.0 * x * (1.0 - x)
    if from_split:
        return x * x, 2.0 * x
    if to_split:
        return x * (2.0 - x), 2.0 * (1.0 - x)
    return x, 1.0


@called
@no_type_check
def grid_nodes(nodes, at, n):
    """Write the midpoints of n x n equal parts of the square.

    Parameters
    ----------
    nodes, at : nodes as in `Room`, written from index `at` on
    n : parts along each side

    Returns
    -------
    next index
    """
    for i in range(n * n):
        nodes[at + i, 0], nodes[at + i, 1] = (i // n + 0.5) / n - 0.5, (i % n + 0.5) / n - 0.5
        nodes[at + i, 2], nodes[at + i, 3] = 1.0 / (n * n), 0.0
    return at + n * n


@njit(error_model="numpy")
@no_type_check
def lattice_step(count):
    """Find the step of a lattice: close to the golden ratio, with no divisor in common with the number of points.

    Parameters
    ----------
    count : number of points

    Returns
    -------
    step, in points
    """
    step = int(_GOLDEN_RATIO * count)
    while gcd(step, count) > 1:
        step += 1
    return step


@inlined
@no_type_check
def lattice_nodes(nodes, at, count):
    """Write the points of a lattice in the square, with as many different places along either side as points.

    So an edge along a side cuts off the correct part to 1 / count, not 1 / sqrt(count) as with a square grid.

    Parameters
    ----------
    nodes, at : nodes as in `Room`, written from index `at` on
    count : number of points

    Returns
    -------
    next index
    """
    step = lattice_step(count)
    for i in range(count):
        nodes[at + i, 0], nodes[at + i, 1] = (i + 0.5) / count - 0.5, (i * step % count + 0.5) / count - 0.5
        nodes[at + i, 2] = 1.0 / count
    return at + count


@njit(error_model="numpy")
@no_type_check
def square_nodes(local, conics, rule_nodes, rule_sizes, lines, nodes, at):
    """Write nodes that average over the square cut by conics; weights sum to 1 up to the error of the rule.

    Parameters
    ----------
    local, conics : conics as in `Room`, and how many of them
    rule_nodes, rule_sizes : one level of `Rules`
    lines : as in `Room`
    nodes, at : nodes as in `Room`, written from index `at` on

    Returns
    -------
    next index
    """
    if conics > CONICS:
        return grid_nodes(nodes, at, np.int64(GRID))
    swapped = _orient(local, conics)
    splits = _outer_splits(local, conics, lines)
    count = at
    low = -0.5
    for i in range(splits + 1):
        high = lines[_SPLITS, i] if i < splits else 0.5
        if high - low < _NARROWEST_PIECE:
            continue
        rule = OUTER + (i > 0) + (i < splits)
        for j in range(rule_sizes[rule]):
            x, slope = _end_map(rule_nodes[rule, 0, j], i > 0, i < splits)
            weight = rule_nodes[rule, 1, j] * slope * (high - low)
            b = low + (high - low) * x
            part = i * (2 * CONICS + 1)  # lines between two splits are cut alike
            rules = (rule_nodes, rule_sizes)
            count = _add_line(local, conics, rules, lines, nodes, count, (b, weight, part))
        low = high
    if swapped:
        for i in range(at, count):
            nodes[i, 0], nodes[i, 1] = nodes[i, 1], nodes[i, 0]
    return count
