"""Discriminants of rays that almost miss a quadric, in twice the working precision.

A chord is the square root of its discriminant. Where this almost vanishes, the rounding of a ray in local coordinates,
1e-16 of its distance, would move the ends of the chord by 1e-8 of the shape. So the few rays that graze begin anew from
world coordinates, with sums and products whose errors are kept (Dekker 1971, doi:10.1007/BF01397083; Dot2 of Ogita,
Rump and Oishi 2005, doi:10.1137/030601818).
"""

from typing import no_type_check

from phantomgen.ops.kernel_decorators import called, inlined
from phantomgen.ops.primitives import BALL, CONE, CYLINDER
from phantomgen.ops.trace.table import KIND, SHIFT, START

# No unit; 2^27 + 1, which splits the 53 bits of a float64 in half (Dekker 1971).
_SPLIT = 134217729.0


@inlined
@no_type_check
def _sum(a, b):
    """``a + b`` rounded, and the error of that."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@inlined
@no_type_check
def _product(a, b):
    """``a b`` rounded, and the error of that."""
    a_high, b_high = _SPLIT * a, _SPLIT * b
    a_high, b_high = a_high - (a_high - a), b_high - (b_high - b)
    a_low, b_low = a - a_high, b - b_high
    product = a * b
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@called
@no_type_check
def _add_product(total, rest, a, a_rest, b, b_rest):
    """``total + a b``, each number the sum of a leading one and a rest."""
    product, error = _product(a, b)
    total, lost = _sum(total, product)
    return _sum(total, rest + (lost + (error + (a * b_rest + a_rest * b))))


@called
@no_type_check
def _map(row, vector, shift):
    """``row . vector + shift``."""
    total, rest = _add_product(shift, 0.0, row[0], 0.0, vector[0], 0.0)
    total, rest = _add_product(total, rest, row[1], 0.0, vector[1], 0.0)
    return _add_product(total, rest, row[2], 0.0, vector[2], 0.0)


@called
@no_type_check
def _add_squared_moment(total, rest, sign, o1, o2, d1, d2):
    """``total + sign (o1 d2 - o2 d1)^2``; o and d are pairs of a leading number and a rest."""
    m, f = _add_product(0.0, 0.0, o1[0], o1[1], d2[0], d2[1])
    m, f = _add_product(m, f, -o2[0], -o2[1], d1[0], d1[1])
    return _add_product(total, rest, sign * m, sign * f, m, f)


@called
@no_type_check
def grazing_discriminant(row, direction):
    """Compute the discriminant of a ray and a ball, a cylinder or a cone.

    Parameters
    ----------
    row : of the table that `solid_table` makes, with the ray's origin filled in
    direction : of the ray (x, y, z) [mm]

    Returns
    -------
    discriminant in local coordinates, no unit; negative where the ray misses
    """
    kind = row[KIND]
    x, y, z = (row[5], row[6], row[7]), (row[8], row[9], row[10]), (row[11], row[12], row[13])
    start = (row[START], row[START + 1], row[START + 2])
    o1, o2, o3 = _map(x, start, row[SHIFT]), _map(y, start, row[SHIFT + 1]), _map(z, start, row[SHIFT + 2])
    d1, d2, d3 = _map(x, direction, 0.0), _map(y, direction, 0.0), _map(z, direction, 0.0)
    total, rest = _add_squared_moment(0.0, 0.0, -1.0, o1, o2, d1, d2)
    if kind != CONE:
        total, rest = _add_product(total, rest, d1[0], d1[1], d1[0], d1[1])
        total, rest = _add_product(total, rest, d2[0], d2[1], d2[0], d2[1])
    if kind == BALL:
        total, rest = _add_product(total, rest, d3[0], d3[1], d3[0], d3[1])
    if kind != CYLINDER:
        sign = 1.0 if kind == CONE else -1.0
        total, rest = _add_squared_moment(total, rest, sign, o2, o3, d2, d3)
        total, rest = _add_squared_moment(total, rest, sign, o3, o1, d3, d1)
    return total + rest
