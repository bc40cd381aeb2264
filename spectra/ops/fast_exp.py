"""A float64 exponential in plain arithmetic, for one value or for eight at once.

numba calls the C library's `exp` one value at a time, and its loop vectoriser gives up on the three to fifteen nodes of
a channel. Splitting 2^k off with two additions and a shift, and the rest by a polynomial of degree 11, is the same few
instructions for a scalar and for a vector; written as LLVM vectors they stay together on every processor.
"""

from math import factorial, log
from typing import Any, no_type_check

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

# float64 numbers that are computed together: 512 bits.
LANES = 8
# Degree of the Taylor polynomial on |x| <= ln 2 / 2: the relative error is below 1e-14.
_DEGREE = 11
# ln 2 in two parts: the first ends in 20 zero bits, so that its product with any exponent k is exact.
_LN2_HIGH = 6.93147180369123816490e-01
_LN2_LOW = 1.90821492927058770002e-10
# Adding 1.5 * 2^52 rounds to the nearest integer and leaves it in the low bits; 1023 is the exponent's bias.
_ROUND = 6755399441055744.0 + 1023.0
# Exponents beyond which float64 underflows or overflows, no unit.
_LOWEST, _HIGHEST = -708.0, 709.0

# llvmlite's values carry no type hints that a checker could follow.
Value = Any

_INDEX = ir.IntType(32)
_INTEGER = ir.IntType(64)
_DOUBLE = ir.DoubleType()
_INTEGERS = ir.VectorType(_INTEGER, LANES)
_DOUBLES = ir.VectorType(_DOUBLE, LANES)
# A product and a sum may become one instruction; nothing may be reordered, or the rounding constant would cancel. numba
# hands a function's flags down to the intrinsics in it, and to functions that do not name their own.
_FUSE = ("contract",)
FLAGS: set[str] = set(_FUSE)


@njit(forceinline=True, fastmath=FLAGS, error_model="numpy")
@no_type_check
def fast_exp(x):
    """Compute the exponential with a relative error below 1e-14.

    Parameters
    ----------
    x : a float64

    Returns
    -------
    exp(x); below -708 it is 0, above 709 it is exp(709), NaN stays NaN
    """
    return _exp(x)


@intrinsic
@no_type_check
def _exp(typing_context, x):
    """`fast_exp` as an instruction sequence."""

    def build(context, builder, signature, args):
        return _exp_of(builder, args[0])

    return types.float64(types.float64), build


@intrinsic
@no_type_check
def attenuated_lanes(typing_context, lengths, columns, weights, at, first, last):
    """Sum of ``weights[k] exp(-sum_m lengths[m] columns[m, k])`` over the nodes k in ``first .. last - 1``.

    Only the `LANES` nodes from `at` on are looked at; all of them must exist. Call it from a function with
    ``fastmath=FLAGS`` only.

    Parameters
    ----------
    typing_context : numba's context; calls leave it out
    lengths : line integrals of one ray, (M,)
    columns : functions at the nodes, (M, K)
    weights : photons x response of each node
    at : first of the `LANES` nodes that are read
    first, last : nodes of the channel are ``first .. last - 1``

    Returns
    -------
    the sum
    """
    signature = types.float64(lengths, columns, weights, types.int64, types.int64, types.int64)

    def build(context, builder, signature, args):
        arrays = [
            context.make_array(kind)(context, builder, value)
            for kind, value in zip(signature.args[:3], args[:3], strict=True)
        ]
        at, first, last = args[3:]
        exponent = _exponent_lanes(builder, arrays[0], arrays[1], at)
        parts = builder.fmul(_load_lanes(builder, arrays[2].data, at), _exp_of(builder, exponent))
        node = builder.add(_spread(builder, at), ir.Constant(_INTEGERS, list(range(LANES))))
        after = builder.icmp_signed(">=", node, _spread(builder, first))
        before = builder.icmp_signed("<", node, _spread(builder, last))
        return _sum_lanes(builder, builder.select(builder.and_(after, before), parts, ir.Constant(_DOUBLES, None)))

    return signature, build


def _exponent_lanes(builder: Any, lengths: Any, columns: Any, at: Value) -> Value:
    """Minus the attenuation at `LANES` nodes, in a loop over the columns."""
    count = cgutils.unpack_tuple(builder, lengths.shape)[0]
    length_stride = cgutils.unpack_tuple(builder, lengths.strides)[0]
    column_stride = cgutils.unpack_tuple(builder, columns.strides)[0]
    total = cgutils.alloca_once_value(builder, ir.Constant(_DOUBLES, None))
    with cgutils.for_range(builder, count) as loop:
        item = cgutils.pointer_add(builder, lengths.data, builder.mul(loop.index, length_stride), _DOUBLE.as_pointer())
        row = cgutils.pointer_add(builder, columns.data, builder.mul(loop.index, column_stride), _DOUBLE.as_pointer())
        product = builder.fmul(
            _spread(builder, builder.fneg(builder.load(item))), _load_lanes(builder, row, at), flags=_FUSE
        )
        builder.store(builder.fadd(builder.load(total), product, flags=_FUSE), total)
    return builder.load(total)


def _exp_of(builder: Any, x: Value) -> Value:
    """Exponential of a double or of a vector of doubles."""
    lanes = x.type.count if isinstance(x.type, ir.VectorType) else 0
    integer = ir.VectorType(_INTEGER, lanes) if lanes else _INTEGER

    def constant(value: float, kind: ir.Type = x.type) -> ir.Constant:
        return ir.Constant(kind, [value] * lanes if lanes else value)

    def fused(a: Value, b: Value, c: Value) -> Value:
        return builder.fadd(builder.fmul(a, b, flags=_FUSE), c, flags=_FUSE)

    too_low = builder.fcmp_ordered("<", x, constant(_LOWEST))
    too_high = builder.fcmp_ordered(">", x, constant(_HIGHEST))
    safe = builder.select(too_low, constant(_LOWEST), builder.select(too_high, constant(_HIGHEST), x))
    shifted = fused(safe, constant(1 / log(2)), constant(_ROUND))
    k = builder.fsub(shifted, constant(_ROUND))
    rest = fused(k, constant(-_LN2_LOW), fused(k, constant(-_LN2_HIGH), safe))
    value = constant(1 / factorial(_DEGREE))
    for n in reversed(range(_DEGREE)):
        value = fused(value, rest, constant(1 / factorial(n)))
    power = builder.bitcast(builder.shl(builder.bitcast(shifted, integer), constant(52, integer)), x.type)
    return builder.select(too_low, constant(0.0), builder.fmul(value, power))


def _load_lanes(builder: Any, first: Value, at: Value) -> Value:
    """`LANES` neighbouring doubles from element `at` on."""
    return builder.load(builder.bitcast(builder.gep(first, [at]), _DOUBLES.as_pointer()), align=8)


def _spread(builder: Any, value: Value) -> Value:
    """Return a vector with one value in all lanes."""
    empty = ir.Constant(ir.VectorType(value.type, LANES), ir.Undefined)
    single = builder.insert_element(empty, value, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(single, empty, ir.Constant(ir.VectorType(_INDEX, LANES), [0] * LANES))


def _sum_lanes(builder: Any, vector: Value) -> Value:
    """Sum over lanes, pairwise."""
    values = [builder.extract_element(vector, ir.Constant(_INDEX, lane)) for lane in range(LANES)]
    while len(values) > 1:
        half = len(values) // 2
        values = [builder.fadd(values[i], values[i + half]) for i in range(half)]
    return values[0]
