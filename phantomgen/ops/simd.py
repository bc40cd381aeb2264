"""Several float32 numbers in one register, as a type that numba kernels can compute with.

Gaussian footprints are a few pixels wide: rows too short for the compiler's own vectoriser, which then falls back to
one pixel at a time (measured: 10 ns per Gaussian and pixel against 1 ns with this type). And where values of several
components lie side by side, places are computed, and waited for, once for all of them. A value of type `Vector` lives
in one LLVM vector; ``+ - * /`` work on all its numbers at once, a float32 operand counts for each. LLVM lowers it to
whatever the processor has (AVX, SSE, NEON). There are eight numbers, except where an argument is a tuple, which is as
long as there are numbers: its values are not used.
"""

import operator
from typing import no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

# Numbers of a vector: 256 bits of float32, the registers of AVX.
WIDTH = 8


class Vector(types.Type):
    """Numba type of several float32 numbers.

    Parameters
    ----------
    count : how many
    """

    def __init__(self, count: int) -> None:
        super().__init__(name=f"Vector({count})")
        self.count = count


float32x8 = Vector(WIDTH)


def _llvm(count: int) -> ir.VectorType:
    return ir.VectorType(ir.FloatType(), count)


_VECTOR = _llvm(WIDTH)


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, manager, fe_type) -> None:
        super().__init__(manager, fe_type, _llvm(fe_type.count))


def _splat(builder, value, count=WIDTH):
    one = builder.insert_element(ir.Constant(_llvm(count), ir.Undefined), value, ir.Constant(ir.IntType(32), 0))
    zeros = ir.Constant(ir.VectorType(ir.IntType(32), count), [0] * count)
    return builder.shuffle_vector(one, ir.Constant(_llvm(count), ir.Undefined), zeros)


def _as_vector(builder, kind, value, count):
    return value if isinstance(kind, Vector) else _splat(builder, value, count)


def _of_operands(a, b) -> Vector | None:
    """Type of what comes of two operands, if they are vectors, or one is and the other a float32."""
    vectors = [kind for kind in (a, b) if isinstance(kind, Vector)]
    others = [kind for kind in (a, b) if not isinstance(kind, Vector)]
    return vectors[0] if vectors and all(v == vectors[0] for v in vectors) and set(others) <= {types.float32} else None


def _define(operation, instruction: str) -> None:
    @intrinsic
    def apply(typingctx, a, b):
        kind = _of_operands(a, b)
        assert kind is not None

        def codegen(context, builder, signature, args):
            left, right = (_as_vector(builder, k, v, kind.count) for k, v in zip(signature.args, args, strict=True))
            return getattr(builder, instruction)(left, right, flags=("fast",))

        return kind(a, b), codegen

    @overload(operation, inline="always")
    def choose(a, b):
        if _of_operands(a, b) is not None:
            return lambda a, b: apply(a, b)  # noqa: PLW0108 # pyright: ignore[reportCallIssue] - numba reads it
        return None


_define(operator.add, "fadd")
_define(operator.sub, "fsub")
_define(operator.mul, "fmul")
_define(operator.truediv, "fdiv")


@intrinsic
def splat(typingctx, value):
    """Repeat a float32 eight times.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    value : the number

    Returns
    -------
    vector
    """
    return float32x8(types.float32), lambda context, builder, signature, args: _splat(builder, args[0])


@intrinsic
def splat_as(typingctx, numbers, value):
    """Repeat a float32 as many times as a tuple is long.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    numbers : the tuple
    value : the number

    Returns
    -------
    vector
    """
    count = numbers.count
    return Vector(count)(numbers, types.float32), lambda context, builder, signature, args: _splat(
        builder, args[1], count
    )


@intrinsic
def ramp(typingctx, first):
    """Count up from a float32 by 1.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    first : the first number

    Returns
    -------
    vector
    """

    def codegen(context, builder, signature, args):
        steps = ir.Constant(_VECTOR, [float(i) for i in range(WIDTH)])
        return builder.fadd(_splat(builder, args[0]), steps, flags=("fast",))

    return float32x8(types.float32), codegen


@intrinsic
def count_from(typingctx, first):
    """Count up from an integer by 1, exactly, however the compiler orders sums.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    first : the first number

    Returns
    -------
    vector of float32
    """

    def codegen(context, builder, signature, args):
        integers = ir.VectorType(ir.IntType(32), WIDTH)
        undefined = ir.Constant(integers, ir.Undefined)
        one = builder.insert_element(undefined, builder.trunc(args[0], ir.IntType(32)), ir.Constant(ir.IntType(32), 0))
        all_equal = builder.shuffle_vector(one, undefined, ir.Constant(integers, [0] * WIDTH))
        return builder.sitofp(builder.add(all_equal, ir.Constant(integers, list(range(WIDTH)))), _VECTOR)

    return float32x8(types.int64), codegen


@intrinsic
def one_more(typingctx, number):
    """Add 1 to a float32, exactly where it is whole, however the compiler orders sums.

    For counters of loops: an instruction that converts the loop's index waits for the value that its register held
    before, which may be the result of the previous turn.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    number : the number

    Returns
    -------
    the sum
    """

    def codegen(context, builder, signature, args):
        return builder.fadd(args[0], ir.Constant(ir.FloatType(), 1.0), flags=("nsz",))

    return types.float32(types.float32), codegen


def _pointer(context, builder, array_type, place, count):
    array, offset = place
    data = context.make_array(array_type)(context, builder, array).data
    return builder.bitcast(builder.gep(data, [offset]), _llvm(count).as_pointer())


@intrinsic
def load(typingctx, array, offset):
    """Load eight numbers of an array; the caller checks bounds.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    array : contiguous, of float32
    offset : flat index of the first number

    Returns
    -------
    vector
    """

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature.args[0], args, WIDTH), align=4)

    return float32x8(array, types.intp), codegen


@intrinsic
def load_as(typingctx, numbers, array, offset):
    """Load as many numbers of an array as a tuple is long; the caller checks bounds.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    numbers : the tuple
    array, offset : as in `load`

    Returns
    -------
    vector
    """
    count = numbers.count

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature.args[1], args[1:], count), align=4)

    return Vector(count)(numbers, array, types.intp), codegen


@intrinsic
def store(typingctx, array, offset, value):
    """Write the numbers of a vector to an array; the caller checks bounds.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    array, offset : as in `load`
    value : the vector

    Returns
    -------
    nothing
    """

    def codegen(context, builder, signature, args):
        place = _pointer(context, builder, signature.args[0], args[:2], value.count)
        builder.store(args[2], place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def square_root(typingctx, value):
    """Compute the square root of each number.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    value : the vector

    Returns
    -------
    vector
    """

    def codegen(context, builder, signature, args):
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_VECTOR, [_VECTOR]), f"llvm.sqrt.v{WIDTH}f32"
        )
        return builder.call(function, args, fastmath=("fast",))

    return float32x8(float32x8), codegen


@intrinsic
def where_less(typingctx, a, limit, value):
    """Select the numbers whose partners are below a limit.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    a : partners of the numbers
    limit : one float32
    value : the numbers

    Returns
    -------
    vector of `value` where ``a < limit``, else 0
    """

    def codegen(context, builder, signature, args):
        inside = builder.fcmp_ordered("<", args[0], _splat(builder, args[1]))
        return builder.select(inside, args[2], ir.Constant(_VECTOR, [0.0] * WIDTH))

    return float32x8(float32x8, types.float32, float32x8), codegen


@intrinsic
def minimum(typingctx, a, limit):
    """Bound numbers from above.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    a : the numbers
    limit : one float32

    Returns
    -------
    vector of the smaller of each number and the limit
    """

    def codegen(context, builder, signature, args):
        bound = _splat(builder, args[1])
        return builder.select(builder.fcmp_ordered("<", args[0], bound), args[0], bound)

    return float32x8(float32x8, types.float32), codegen


@intrinsic
def total(typingctx, value):
    """Sum eight numbers pairwise.

    Parameters
    ----------
    typingctx : context of numba, not part of the call
    value : the vector

    Returns
    -------
    float32
    """

    def codegen(context, builder, signature, args):
        vector = args[0]
        for half in (4, 2, 1):
            index = ir.VectorType(ir.IntType(32), half)
            undefined = ir.Constant(vector.type, ir.Undefined)
            low = builder.shuffle_vector(vector, undefined, ir.Constant(index, list(range(half))))
            high = builder.shuffle_vector(vector, undefined, ir.Constant(index, list(range(half, 2 * half))))
            vector = builder.fadd(low, high, flags=("fast",))
        return builder.extract_element(vector, ir.Constant(ir.IntType(32), 0))

    return types.float32(float32x8), codegen


f4 = np.float32


@njit(inline="always")
@no_type_check
def exp_negative(x):
    """Compute exp(x), by the Taylor polynomial of exp(x / 16), squared four times.

    Parameters
    ----------
    x : vector in [-12.5, 0]

    Returns
    -------
    vector; the error is below 1e-6, the relative error below 2e-6 down to -3, 2e-5 at -6.9 and 1.2e-3 at -12.5
    """
    t = x * f4(1 / 16)
    p = t * f4(1 / 720) + f4(1 / 120)
    p = p * t + f4(1 / 24)
    p = p * t + f4(1 / 6)
    p = p * t + f4(1 / 2)
    p = p * t + f4(1)
    p = p * t + f4(1)
    p = p * p
    p = p * p
    p = p * p
    return p * p
