"""Which shapes have a common interior, and which enclose each other: closed forms and brute force."""

import numpy as np
import pytest

from phantomgen.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Difference,
    Ellipsoid,
    HalfSpace,
    Intersection,
    Sphere,
    Torus,
)
from phantomgen.shapes.intersection_tests import _farthest, encloses, meet

ROOT = 1 / np.sqrt(2)


@pytest.mark.parametrize(
    ("first", "second", "touching"),
    [  # the second one moved by s along x touches the first one for s = touching
        (Sphere((0, 0, 0), 1), lambda s: Sphere((s, 0, 0), 2), 3.0),
        (Sphere((0, 0, 0), 1), lambda s: Ellipsoid((s, 0, 0), (2, 1, 1), (0, 0, np.pi / 4)), 1 + np.sqrt(2.5)),
        (Box((0, 0, 0), (2, 2, 2)), lambda s: Box((s, 0, 0), (2, 2, 2), (0, 0, np.pi / 4)), 1 + np.sqrt(2)),
        (Cylinder((0, 0, 0), 1, 2), lambda s: Cylinder((s, 0, 0), 1, 9, (0, 1, 0)), 2.0),
        (Cylinder((0, 0, 0), 1, 2), lambda s: Cylinder((s, 0, 0), 1, 8, (1, 0, 0)), 5.0),
        (Cone((0, 0, 0), (3, 0), 4), lambda s: Sphere((s, 0, 0), 1), 1.5 + 1.25),
        (Box((0, 0, 0), (2, 2, 2)), lambda s: Intersection((Sphere((s, 0, 0), 3), HalfSpace((-1, 0, 0), -s))), 1.0),
        (Torus((0, 0, 0), 5, 1), lambda s: Box((s, 0, 0), (2, 9, 9)), 7.0),
    ],
)
def test_shapes_meet_until_they_touch(first, second, touching) -> None:
    touching_box = isinstance(first, Sphere) and isinstance(second(0.0), Ellipsoid)
    near = 0.3 if touching_box else 1e-3 * touching
    assert meet([first, second(touching - near)])
    assert not meet([first, second(touching + 1e-3)])


def test_three_spheres_that_meet_two_by_two() -> None:
    def around(radius: float) -> list[Sphere]:
        return [Sphere((np.cos(a), np.sin(a), 0.0), radius) for a in np.deg2rad([0, 120, 240])]

    assert all(meet([a, b]) for a, b in zip(around(0.95), around(0.95)[1:], strict=False))
    assert not meet(around(0.999))
    assert meet(around(1.001))


@pytest.mark.parametrize(
    ("outer", "inner", "answer"),
    [
        (Sphere((0, 0, 0), 2), Ellipsoid((0.5, 0, 0), (1.45, 0.5, 0.5)), True),
        (Sphere((0, 0, 0), 2), Ellipsoid((0.5, 0, 0), (1.55, 0.5, 0.5)), False),
        (Cylinder((0, 0, 0), 2, 4), Cylinder((0, 0, 0), 2, 4), True),
        (Cylinder((0, 0, 0), 2, 4), Cylinder((0, 0, 1.1), 1, 2), False),
        (Sphere((0, 0, 0), 1.001), Box((0, 0, 0), (2 * ROOT, 2 * ROOT, 0.01)), True),
        (Box((0, 0, 0), (2, 2, 2)), Sphere((0, 0, 0), 1), True),
        (Box((0, 0, 0), (2, 2, 2)), Torus((0, 0, 0), 0.8, 0.15), True),
        (Cone((0, 0, 0), (3, 1), 4), Sphere((0, 0, 0), 0.1), False),  # it does, but that is not looked for
        (Box((0, 0, 0), (9, 9, 9)), Capsule((0, 0, 0), 1, 3, (1, 1, 1)), True),
        (Difference(Sphere((0, 0, 0), 3), (Sphere((0, 0, 0), 1),)), Sphere((0, 0, 0), 0.5), False),
        (Sphere((0, 0, 0), 3), Difference(Sphere((0, 0, 0), 2), (Sphere((0, 0, 0), 1),)), True),
        (Intersection((Sphere((0, 0, 0), 3), HalfSpace((1, 0, 0), 0))), Sphere((-1, 0, 0), 0.9), True),
        (Intersection((Sphere((0, 0, 0), 3), HalfSpace((1, 0, 0), 0))), Sphere((-1, 0, 0), 1.1), False),
    ],
)
def test_enclosing(outer, inner, answer) -> None:
    assert encloses(outer, inner) is answer


@pytest.mark.parametrize("axes", [1, 2, 3])
def test_the_farthest_point_of_an_ellipsoid(axes: int) -> None:
    rng = np.random.default_rng(axes)
    unit = rng.normal(size=(100_000, axes))
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    for _ in range(20):
        offset, matrix = rng.normal(size=3), rng.normal(size=(3, axes))
        brute = np.linalg.norm(offset + unit @ matrix.T, axis=1).max()
        assert brute - 1e-9 <= _farthest(offset, matrix) <= brute * (1 + 2e-3)
