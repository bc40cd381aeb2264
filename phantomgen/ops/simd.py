"""Several float32 numbers in one register, as a type that numba kernels can compute with.

Gaussian footprints are a few pixels wide: rows too short for the compiler's own vectoriser, which then falls back to
one pixel at a time (measured: 10 ns per Gaussian and pixel against 1 ns with this type). And where values of several
components lie side by side, places are computed, and waited for, once for all of them. A value of type `Vector` lives
in one LLVM vector; ``+ - * /`` work on all its numbers at once, a float32 operand counts for each. LLVM lowers it to
whatever the processor has (AVX, SSE, NEON). There are eight numbers but where a tuple says how many: its values do not
count.
"""

import operator
from typing import no_type_check

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic, models, overload, register_model

WIDTH = 8


class Vector(types.Type):
    """Numba type of `count` float32 numbers."""

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
    """Eight times the float32 `value`."""
    return float32x8(types.float32), lambda context, builder, signature, args: _splat(builder, args[0])


@intrinsic
def splat_as(typingctx, numbers, value):
    """The float32 `value`, as many times as the tuple `numbers` is long."""
    count = numbers.count
    return Vector(count)(numbers, types.float32), lambda context, builder, signature, args: _splat(
        builder, args[1], count
    )


@intrinsic
def ramp(typingctx, first):
    """`first`, `first` + 1, ... `first` + 7."""

    def codegen(context, builder, signature, args):
        steps = ir.Constant(_VECTOR, [float(i) for i in range(WIDTH)])
        return builder.fadd(_splat(builder, args[0]), steps, flags=("fast",))

    return float32x8(types.float32), codegen


@intrinsic
def count_from(typingctx, first):
    """The integers `first`, `first` + 1, ... `first` + 7 as float32, exactly, however the compiler orders sums."""

    def codegen(context, builder, signature, args):
        integers = ir.VectorType(ir.IntType(32), WIDTH)
        undefined = ir.Constant(integers, ir.Undefined)
        one = builder.insert_element(undefined, builder.trunc(args[0], ir.IntType(32)), ir.Constant(ir.IntType(32), 0))
        all_equal = builder.shuffle_vector(one, undefined, ir.Constant(integers, [0] * WIDTH))
        return builder.sitofp(builder.add(all_equal, ir.Constant(integers, list(range(WIDTH)))), _VECTOR)

    return float32x8(types.int64), codegen


@intrinsic
def one_more(typingctx, number):
    """`number` + 1, a float32, exactly where it is whole, however the compiler orders sums.

    Counts along in a loop. To convert the loop's index in each turn costs more than it seems: the instruction waits for
    what its register held before, and that may be the end of the turn before.
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
    """Eight numbers of a contiguous float32 `array`, from flat index `offset` on; bounds are the caller's duty."""

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature.args[0], args, WIDTH), align=4)

    return float32x8(array, types.intp), codegen


@intrinsic
def load_as(typingctx, numbers, array, offset):
    """As many numbers as the tuple `numbers` is long, otherwise as `load`."""
    count = numbers.count

    def codegen(context, builder, signature, args):
        return builder.load(_pointer(context, builder, signature.args[1], args[1:], count), align=4)

    return Vector(count)(numbers, array, types.intp), codegen


@intrinsic
def store(typingctx, array, offset, value):
    """Write a vector's numbers into a contiguous float32 `array`, from flat index `offset` on."""

    def codegen(context, builder, signature, args):
        place = _pointer(context, builder, signature.args[0], args[:2], value.count)
        builder.store(args[2], place, align=4)
        return context.get_dummy_value()

    return types.void(array, types.intp, value), codegen


@intrinsic
def square_root(typingctx, value):
    """Square root of each number."""

    def codegen(context, builder, signature, args):
        function = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(_VECTOR, [_VECTOR]), f"llvm.sqrt.v{WIDTH}f32"
        )
        return builder.call(function, args, fastmath=("fast",))

    return float32x8(float32x8), codegen


@intrinsic
def where_less(typingctx, a, limit, value):
    """`value` where `a` < `limit`, else 0; `limit` is one float32."""

    def codegen(context, builder, signature, args):
        inside = builder.fcmp_ordered("<", args[0], _splat(builder, args[1]))
        return builder.select(inside, args[2], ir.Constant(_VECTOR, [0.0] * WIDTH))

    return float32x8(float32x8, types.float32, float32x8), codegen


@intrinsic
def minimum(typingctx, a, limit):
    """The smaller of `a` and one float32 `limit`."""

    def codegen(context, builder, signature, args):
        bound = _splat(builder, args[1])
        return builder.select(builder.fcmp_ordered("<", args[0], bound), args[0], bound)

    return float32x8(float32x8, types.float32), codegen


@intrinsic
def total(typingctx, value):
    """Sum of the eight numbers, pairwise."""

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
    """exp(x) for x in [-12.5, 0], error below 1e-6: the Taylor polynomial of exp(x / 16), squared four times.

    The relative error is below 2e-6 down to -3, 2e-5 at -6.9 and 1.2e-3 at -12.5.
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
