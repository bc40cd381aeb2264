import numpy as np
import pytest
from numba import njit

from phantomgen.ops.simd import (
    WIDTH,
    count_from,
    exp_negative,
    load,
    load_as,
    minimum,
    one_more,
    ramp,
    splat,
    splat_as,
    square_root,
    store,
    total,
    where_less,
)

f4 = np.float32


@njit
def every_operation(a, b, number, first, out):
    """One result per row of `out`; `a` and `b` hold eight numbers."""
    x, y = load(a, 0), load(b, 0)
    results = (
        x + y, x - y, x * y, x / y, x + number, number - x, x * number, splat(number), ramp(number),
        count_from(first), square_root(x), where_less(x, number, y), minimum(x, number), splat(total(x)),
    )  # fmt: skip
    for i in range(len(results)):
        store(out, i * WIDTH, results[i])


def test_operations_do_what_numpy_does():
    rng = np.random.default_rng(1)
    a, b = rng.uniform(0.1, 3, (2, WIDTH)).astype(f4)
    number, first = f4(1.3), -5
    out = np.empty((14, WIDTH), f4)
    every_operation(a, b, number, first, out)
    steps = np.arange(WIDTH, dtype=f4)
    expected = [
        a + b, a - b, a * b, a / b, a + number, number - a, a * number, np.full(WIDTH, number), number + steps,
        first + steps, np.sqrt(a), np.where(a < number, b, 0), np.minimum(a, number), np.full(WIDTH, a.sum()),
    ]  # fmt: skip
    np.testing.assert_allclose(out, expected, rtol=1e-6)


@njit
def of_any_length(numbers, a, b, number, out):
    """A sum and a product of as many numbers as `numbers` has, from the second one on."""
    x, y = load_as(numbers, a, 1), load_as(numbers, b, 1)
    store(out, 1, x + y * number - splat_as(numbers, number))


@pytest.mark.parametrize("count", [1, 2, 3, 5, 8, 16])
def test_vectors_are_as_long_as_the_tuple_and_leave_the_rest(count):
    a, b = np.random.default_rng(2).uniform(0.1, 3, (2, count + 2)).astype(f4)
    out = np.zeros(count + 2, f4)
    of_any_length((f4(0),) * count, a, b, f4(1.3), out)
    expected = a + b * f4(1.3) - f4(1.3)
    expected[[0, -1]] = 0
    np.testing.assert_allclose(out, expected, rtol=1e-5, atol=1e-6)


@njit
def exponentials(x, out):
    for i in range(len(x)):
        out[i] = exp_negative(x[i])


@pytest.mark.parametrize(("lowest", "relative"), [(-3, 2e-6), (-6.9, 2e-5), (-10.2, 3e-4), (-12.5, 1.2e-3)])
def test_exponential_keeps_the_error_it_states(lowest, relative):
    x = np.linspace(lowest, 0, 20001).astype(f4)
    out = np.empty_like(x)
    exponentials(x, out)
    truth = np.exp(x.astype(float))
    assert abs(out - truth).max() < 1e-6
    assert abs(out / truth - 1).max() < relative


@njit(fastmath=True)
def counted(start, place, out):
    """Distances of whole numbers from `start` on to a place."""
    number = start
    for i in range(len(out)):
        number = one_more(number)
        out[i] = number - place


def test_counting_is_exact_where_the_compiler_may_reorder_sums():
    start, place, out = f4(-40), f4(0.12345678), np.empty(80, f4)
    counted(start, place, out)
    np.testing.assert_array_equal(out, np.arange(-39, 41).astype(f4) - place)
