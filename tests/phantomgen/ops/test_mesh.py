"""Rays through closed triangle meshes: analytic shapes, even crossings, lists per pixel, outlines."""

import numpy as np
import pytest
import trimesh

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.mesh import (
    CREASE,
    PLAIN,
    SILHOUETTE,
    Surfaces,
    cpu,
    mesh_crossings,
    mesh_intervals,
    mesh_lengths,
    mesh_view,
)
from phantomgen.ops.mesh.reference import length_one
from phantomgen.ops.trace import trace
from phantomgen.shapes import Box, Shape, Sphere, rotation_matrix, solids_of
from spectra.errors import InputError

SIDE = 48
FRAMES = Geometry.circular(100.0, 180.0, np.array([0.0, 0.3, 2.1]), Panel(SIDE, SIDE, (1.5, 1.3))).ray_frames()
DOWN = np.array([[0.0, 0, 16], [0, 0, -8], [1, 0, 0], [0, 1, 0]])  # lines along z, u = x and v = y

MeshArrays = tuple[np.ndarray, np.ndarray]


def box_mesh(box: Box) -> MeshArrays:
    mesh = trimesh.creation.box()
    return np.array(box.center) + 2 * np.array(mesh.vertices) @ box.axes.T, np.array(mesh.faces)


def ball_mesh(subdivisions: int, radius: float) -> MeshArrays:
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.array(mesh.vertices), np.array(mesh.faces)


def knot_mesh() -> MeshArrays:
    """A ring of long thin triangles that turn about its core."""
    mesh = trimesh.creation.torus(15.0, 5.0, major_sections=12, minor_sections=40)
    return np.array(mesh.vertices) @ rotation_matrix((0.4, 0.9, 0.2)).T, np.array(mesh.faces)


def projected(frame: np.ndarray, points: np.ndarray) -> np.ndarray:
    depth, a, b = np.linalg.solve(frame[1:].T, (points - frame[0]).T)
    return np.stack([a / depth, b / depth], axis=1)


def aimed(frame: np.ndarray, mesh: MeshArrays, count: int) -> np.ndarray:
    """Rays through vertices, points of edges, and points of faces near their corners."""
    vertices, triangles = mesh
    rng = np.random.default_rng(4)
    p, q, r = vertices[triangles[rng.integers(len(triangles), size=count // 2)].T]
    part, small = rng.random((count // 2, 1)), 1e-13 * rng.normal(size=(count // 2, 1))
    edges = p + part * (q - p)
    corners = p + np.where(rng.random((count // 2, 1)) < 0.5, 0, small) * (r - p)
    return projected(frame, np.concatenate([edges, corners]))


def analytic(frame: np.ndarray, uv: np.ndarray, shape: Shape) -> np.ndarray:
    directions = frame[1] + uv @ frame[2:]
    origins = np.broadcast_to(frame[0], directions.shape)
    return trace(origins, directions, solids_of([(shape, 0)]), 1)[:, 0]


def by_formula(frame: np.ndarray, uv: np.ndarray, mesh: MeshArrays) -> list[float]:
    return [length_one(frame[0], frame[1] + u * frame[2] + v * frame[3], *mesh) for u, v in uv]


def moved_source(point: tuple) -> np.ndarray:
    return np.stack([np.array(point, dtype=np.float64), *FRAMES[0, 1:]])


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.0), (0.3, 0.5, 0.7)])
@pytest.mark.parametrize("view", range(3))
def test_box_mesh_is_the_box(rotation: tuple, view: int) -> None:
    box = Box((1.0, -2.0, 3.0), (20.0, 14.0, 9.0), rotation)
    mesh, frame = box_mesh(box), FRAMES[view]
    random = np.random.default_rng(view).uniform(-5, SIDE + 5, (4000, 2))
    for uv in (random, aimed(frame, mesh, 4000), np.indices((SIDE, SIDE)).reshape(2, -1).T.astype(np.float64)):
        np.testing.assert_allclose(mesh_lengths(frame, uv, *mesh), analytic(frame, uv, box), atol=1e-9)


def test_lines_within_faces_belong_to_one_side() -> None:
    mesh = box_mesh(Box((0, 0, 0), (2, 2, 2)))
    axis = np.array([-2.0, -1.0, -0.5, 0.0, 0.5, 1.0, 2.0])
    uv = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    found = mesh_lengths(DOWN, uv, *mesh, parallel=True)
    within = ((uv >= -1) & (uv < 1)).all(axis=1)
    assert found.tolist() == np.where(within, 2.0, 0.0).tolist()


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.3, 0.5, 0.7)])
@pytest.mark.parametrize(
    ("direction", "lengths"),
    [((1, 1, 1), (2 * 3**0.5,)), ((1, 0, 0), (0, 2)), ((1, 1, 0), (0, 2 * 2**0.5)), ((1, 2, 0), (0, 5**0.5))],
    ids=["through two corners", "along an edge", "along a diagonal of a face", "within a face"],
)
@pytest.mark.parametrize("distance", [0.0, 1.0, 3.0])
def test_rays_along_edges_and_faces(turn: tuple, direction: tuple, lengths: tuple, distance: float) -> None:
    box = Box((0, 0, 0), (2, 2, 2), turn)
    ends = np.array([[-1, -1, 1 - 2 * direction[2]], direction], dtype=np.float64) @ box.axes.T
    frame = np.stack([ends[0] - distance * ends[1], 8 * ends[1], *(box.axes.T[1:] + 0.25)])
    uv = np.array([[0.0, 0.0], [1e-15, 0], [-1e-15, 0], [0, 1e-15], [1e-15, -1e-15]])
    found = mesh_lengths(frame, uv, *box_mesh(box))
    assert found.min() >= -1e-12
    assert found.max() <= max(lengths) + 1e-12
    if len(lengths) == 1:
        np.testing.assert_allclose(found, lengths[0], atol=1e-12)
    elif turn == (0.0, 0.0, 0.0):
        assert abs(np.subtract.outer(found, lengths)).min(axis=1).max() < 1e-12
    counts = np.diff(mesh_crossings(frame, uv, *box_mesh(box))[0])
    assert distance == 0 or (counts % 2 == 0).all()


@pytest.mark.parametrize("mesh", [ball_mesh(2, 20.0), knot_mesh()], ids=["ball", "ring"])
@pytest.mark.parametrize("source", [(100, 0, 0), (12, 3, 2), (0, 0, 0), (0, 14, 0), (-40, 0, 0)])
def test_agrees_with_the_formula(mesh: MeshArrays, source: tuple) -> None:
    frame = moved_source(source)
    uv = np.random.default_rng(3).uniform(-30, SIDE + 30, (500, 2))
    np.testing.assert_allclose(mesh_lengths(frame, uv, *mesh), by_formula(frame, uv, mesh), atol=1e-10)


@pytest.mark.parametrize("mesh", [box_mesh(Box((0, 0, 0), (9, 8, 7))), ball_mesh(4, 20.0), knot_mesh()])
@pytest.mark.parametrize("view", range(3))
def test_every_ray_crosses_an_even_number_of_times(mesh: MeshArrays, view: int) -> None:
    frame = FRAMES[view]
    uv = np.concatenate([aimed(frame, mesh, 100_000), np.random.default_rng(view).uniform(0, SIDE, (50_000, 2))])
    starts, places = mesh_crossings(frame, uv, *mesh)
    assert (np.diff(starts) % 2 == 0).all()
    assert len(places) > 0.8 * len(uv)
    vertices = mesh[0]
    depth = (vertices - frame[0]) @ np.linalg.inv(frame[1:].T)[0]
    assert depth.min() - 1e-12 < places.min() <= places.max() < depth.max() + 1e-12


def test_rays_from_inside_cross_an_odd_number_of_times() -> None:
    mesh, frame = ball_mesh(4, 20.0), moved_source((3, -2, 1))
    uv = aimed(frame, mesh, 100_000)
    uv = np.concatenate([uv[(abs(uv) < 200).all(axis=1)], np.random.default_rng(0).uniform(-200, 200, (20_000, 2))])
    starts, places = mesh_crossings(frame, uv, *mesh)
    assert (np.diff(starts) % 2 == 1).all()
    assert places.min() > 0
    np.testing.assert_allclose(mesh_lengths(frame, uv, *mesh), analytic(frame, uv, Sphere((0, 0, 0), 20.0)), atol=0.1)


def test_a_box_beside_and_behind_the_source_counts_where_it_is_in_front() -> None:
    box = Box((0.0, 12.0, 1.0), (90.0, 20.0, 30.0))
    uv = np.random.default_rng(0).uniform(-200, 200, (5000, 2))
    for source in ((10, 0, 0), (-30, -3, 4), (0, 11, 0), (10, 2, 0)):  # the last one on a face
        frame = moved_source(source)
        found, expected = mesh_lengths(frame, uv, *box_mesh(box)), analytic(frame, uv, box)
        np.testing.assert_allclose(found, expected, atol=1e-9)
        assert (expected > 0).sum() > 500


def test_mesh_behind_source_or_panel_is_not_met() -> None:
    uv = np.random.default_rng(0).uniform(0, SIDE, (500, 2))
    for x in (150.0, -110.0):
        assert mesh_lengths(FRAMES[0], uv, *box_mesh(Box((x, 0, 0), (20, 90, 90)))).max() == 0


def test_ball_mesh_comes_close_to_the_ball_with_the_square_of_the_edge() -> None:
    uv = np.random.default_rng(0).uniform(0, SIDE, (4000, 2))
    exact = analytic(FRAMES[0], uv, Sphere((0, 0, 0), 15.0))
    errors = [np.abs(mesh_lengths(FRAMES[0], uv, *ball_mesh(n, 15.0)) - exact).mean() for n in (2, 3, 4, 5)]
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, atol=0.5)
    assert errors[-1] < 0.02


def test_a_shell_of_a_tenth_of_a_micrometre_is_met_twice() -> None:
    outer, inner = ball_mesh(4, 20.0), ball_mesh(4, 20.0 - 1e-4)
    shell = np.concatenate([outer[0], inner[0]]), np.concatenate([outer[1], inner[1][:, ::-1] + len(outer[0])])
    uv = np.concatenate([aimed(FRAMES[1], outer, 10_000), np.random.default_rng(0).uniform(0, SIDE, (10_000, 2))])
    expected = mesh_lengths(FRAMES[1], uv, *outer) - mesh_lengths(FRAMES[1], uv, *inner)
    np.testing.assert_allclose(mesh_lengths(FRAMES[1], uv, *shell), expected, atol=1e-10)


def lengths_in_pixels(frame: np.ndarray, meshes: list[MeshArrays], uv: np.ndarray, **options) -> np.ndarray:
    """Lengths in all meshes of rays within the panel, with the lists of their pixels; t runs as long as the rays."""
    view = mesh_view(frame, SIDE, SIDE + 3, Surfaces.of(meshes), **options)
    column, row = np.minimum(np.floor(uv + 0.5), SIDE - 1).astype(np.int64).T
    out = np.empty((len(meshes), len(uv)))
    for m in range(len(meshes)):
        at = row * (SIDE + 3) + column
        cpu.ray_lengths(view.lists(m), uv, at, np.ones(len(uv)), np.empty(view.room), out[m])
    return out


@pytest.mark.parametrize("source", [(100, 0, 0), (12, 3, 2), (0, 14, 0), (22, 9, 4)])
def test_lists_of_pixels_hold_all_that_is_met(source: tuple) -> None:
    frame = moved_source(source)
    meshes = [knot_mesh(), box_mesh(Box((0, 0, 0), (30, 1, 40), (0.3, 0.2, 0.4))), ball_mesh(4, 13.0)]
    uv = np.random.default_rng(5).uniform(-0.5, SIDE - 0.5, (20_000, 2))
    uv[::2] = np.floor(uv[::2]) + 0.5  # corners of pixels
    norms = np.linalg.norm(frame[1] + uv @ frame[2:], axis=1)
    found = lengths_in_pixels(frame, meshes, uv) * norms
    single = [mesh_lengths(frame, uv[i : i + 1], *mesh)[0] for mesh in meshes for i in range(300)]
    np.testing.assert_allclose(found[:, :300].ravel(), single, atol=1e-10)
    together = [mesh_lengths(frame, uv, *mesh) for mesh in meshes]
    np.testing.assert_allclose(found, together, atol=1e-10)
    assert found.max() > 2


def test_lists_of_columns_hold_all_that_is_met() -> None:
    frame = DOWN + np.array([[0, 0, 32], [-20, -20, -16], [-0.2, 0, 0], [0, -0.1, 0]])
    uv = np.random.default_rng(6).uniform(-0.5, SIDE - 0.5, (5000, 2))
    found = 48 * lengths_in_pixels(frame, [knot_mesh()], uv, parallel=True)[0]
    np.testing.assert_allclose(found, mesh_lengths(frame, uv, *knot_mesh(), parallel=True), atol=1e-10)
    assert found.max() > 8


@pytest.mark.parametrize("source", [(100, 0, 0), (22, 9, 4)])
def test_outline_holds_every_pixel_where_some_rays_miss(source: tuple) -> None:
    frame, mesh = moved_source(source), knot_mesh()
    n = 12
    places = (np.indices((SIDE * n, SIDE * n)).reshape(2, -1).T[:, ::-1] + 0.5) / n - 0.5
    met = (mesh_lengths(frame, places, *mesh) > 0).reshape(SIDE, n, SIDE, n)
    mixed = met.any(axis=(1, 3)) & ~met.all(axis=(1, 3))
    outline = mesh_view(frame, SIDE, SIDE, Surfaces.of([mesh])).outline
    assert mixed.sum() > 50
    assert (outline[mixed] == SILHOUETTE).all()


def test_outline_of_smooth_and_of_angular_meshes() -> None:
    ball = mesh_view(FRAMES[0], SIDE, SIDE, Surfaces.of([ball_mesh(4, 15.0)])).outline
    assert set(ball.ravel()) == {PLAIN, SILHOUETTE}
    assert 60 < (ball == SILHOUETTE).sum() < 4 * 60
    box = mesh_view(FRAMES[1], SIDE, SIDE, Surfaces.of([box_mesh(Box((0, 0, 0), (20, 20, 20), (0.5, 0.4, 0)))])).outline
    assert set(box.ravel()) == {PLAIN, CREASE, SILHOUETTE}
    assert (box == PLAIN).sum() > SIDE**2 / 2


def test_rays_from_anywhere_to_anywhere() -> None:
    rng = np.random.default_rng(9)
    origins = np.repeat(rng.normal(size=(20, 3)) * 25, 40, axis=0)
    directions = rng.normal(size=(800, 3)) * 40
    directions[5] = 0
    meshes = [knot_mesh(), ball_mesh(2, 12.0)]
    starts, ends = mesh_intervals(origins, directions, Surfaces.of(meshes))
    assert starts.shape == (2, 801)
    assert (ends[:, 0] < ends[:, 1]).all()
    assert (ends.min(), ends.max()) == (0, 1)
    for m, mesh in enumerate(meshes):
        sums = np.add.reduceat(np.append(ends[:, 1] - ends[:, 0], 0), starts[m, :-1]) * (np.diff(starts[m]) > 0)
        expected = [length_one(o, d, *mesh) for o, d in zip(origins, directions, strict=True)]
        np.testing.assert_allclose(sums * np.linalg.norm(directions, axis=1), expected, atol=1e-10)
    assert mesh_intervals(origins, directions, Surfaces.of([]))[0].shape == (0, 801)


def test_order_of_triangles_and_vertices_does_not_matter() -> None:
    vertices, triangles = knot_mesh()
    rng = np.random.default_rng(8)
    place = rng.permutation(len(vertices))
    shuffled = vertices[np.argsort(place)], place[triangles][rng.permutation(len(triangles))]
    uv = rng.uniform(0, SIDE, (5000, 2))
    np.testing.assert_allclose(
        mesh_lengths(FRAMES[1], uv, vertices, triangles), mesh_lengths(FRAMES[1], uv, *shuffled), atol=1e-11
    )


def test_nothing_to_meet() -> None:
    view = mesh_view(FRAMES[0], 4, 5, Surfaces.of([]))
    assert view.starts.shape == (0, 21)
    assert view.outline.sum() == 0
    assert mesh_lengths(FRAMES[0], np.empty((0, 2)), *ball_mesh(1, 1.0)).shape == (0,)
    assert mesh_lengths(FRAMES[0], np.zeros((3, 2)), np.empty((0, 3)), np.empty((0, 3), np.int64)).tolist() == [0, 0, 0]


@pytest.mark.wrong_types
def test_refuses_what_would_leave_the_arrays() -> None:
    vertices, triangles = ball_mesh(0, 1.0)
    with pytest.raises(InputError, match=r"0\.\.11, got 0\.\.12"):
        Surfaces.of([(vertices, triangles + (triangles == 11))])
    with pytest.raises(InputError, match="finite"):
        mesh_lengths(FRAMES[0], np.zeros((1, 2)), vertices + np.inf, triangles)
    with pytest.raises(InputError, match=r"\(ray, 2\)"):
        mesh_lengths(FRAMES[0], np.zeros(2), vertices, triangles)
    with pytest.raises(InputError, match="one plane"):
        mesh_lengths(FRAMES[0] * [1, 0, 1], np.zeros((1, 2)), vertices, triangles)
