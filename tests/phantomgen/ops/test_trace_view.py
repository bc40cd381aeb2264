"""Path lengths of a whole view: those of its rays one by one, and of the reference."""

import numpy as np
import pytest
import trimesh

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.trace import trace, trace_view
from phantomgen.ops.trace.reference import trace_one
from phantomgen.shapes import Box, Cylinder, Difference, Ellipsoid, Mesh, Shape, Sphere, Torus, solids_of

FRAME = Geometry.circular(500.0, 800.0, np.array([0.3]), Panel(30, 34, 6.0)).ray_frames()[0]
BODY: tuple[Shape, int] = (Cylinder((0, 0, 0), 50.0, 100.0), 0)
BALL = trimesh.creation.icosphere(2, 20.0)
SCENES: dict[str, list[tuple[Shape, int]]] = {
    "nothing": [],
    "nested": [
        BODY,
        (Sphere((5, 0, 0), 20.0), 1),
        (Box((5, 0, 0), (10, 8, 6), (1, 2, 3)), 2),
        (Sphere((-30, 0, 0), 9), 2),
    ],
    "covered": [(Sphere((0, 0, 0), 20.0), 1), BODY],
    "overlapping": [BODY, (Sphere((40, 0, 0), 20.0), 1), (Ellipsoid((30, 5, 0), (10, 30, 8), (1, 0, 0)), 2)],
    "ring": [BODY, (Torus((0, 0, 0), 25.0, 6.0, (1, 0.2, 0.1)), 1)],
    "difference": [BODY, (Difference(Sphere((0, 0, 0), 30.0), (Box((10, 0, 0), (20, 30, 40)),)), 1)],
    "mesh": [BODY, (Mesh(np.asarray(BALL.vertices), np.asarray(BALL.faces)), 1)],
}


@pytest.mark.parametrize("background", [-1, 3])
@pytest.mark.parametrize("name", SCENES)
def test_is_what_its_rays_are(name: str, background: int) -> None:
    solids = solids_of(SCENES[name])
    found = trace_view(FRAME, 30, 34, solids, 4, background)
    row, column = np.divmod(np.arange(30 * 34), 34)
    directions = FRAME[1] + column[:, None] * FRAME[2] + row[:, None] * FRAME[3]
    expected = trace(np.tile(FRAME[0], (len(directions), 1)), directions, solids, 4, background)
    np.testing.assert_allclose(found.reshape(-1, 4), expected, atol=1e-10)


def test_agrees_with_sorted_events() -> None:
    solids = solids_of(SCENES["nested"])
    found = trace_view(FRAME, 30, 34, solids, 4)
    for row in range(3, 30, 4):
        for column in range(1, 34, 5):
            direction = FRAME[1] + column * FRAME[2] + row * FRAME[3]
            np.testing.assert_allclose(found[row, column], trace_one(FRAME[0], direction, solids, 4), atol=1e-10)
