"""Meshes as shapes: files and units, volumes, points inside, and surfaces that are refused."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from phantomgen.shapes import Box, Mesh, load_mesh
from spectra.errors import InputError

DATA = Path(__file__).parent / "data"
BALL = trimesh.creation.icosphere(2, 20.0)


def mesh_of(source: trimesh.Trimesh, **options) -> Mesh:
    return Mesh(np.array(source.vertices), np.array(source.faces), **options)


def joined(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.util.concatenate(list(parts))


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb", "3mf"])
def test_files_of_every_format(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"ball.{suffix}"
    BALL.export(path)
    mesh = load_mesh(path, "mm")
    assert (len(mesh.vertices), len(mesh.triangles)) == (len(BALL.vertices), len(BALL.faces))
    assert mesh.volume == pytest.approx(BALL.volume, rel=1e-6)
    assert repr(mesh) == f"Mesh(ball.{suffix}: 320 triangles)"


@pytest.mark.parametrize(("unit", "factor"), [("um", 1e-3), ("mm", 1), ("cm", 10), ("m", 1000), ("inch", 25.4)])
def test_units(unit: str, factor: float, tmp_path: Path) -> None:
    BALL.export(tmp_path / "ball.ply")
    low, high = load_mesh(tmp_path / "ball.ply", unit).bounds
    np.testing.assert_allclose([low, high], np.array(BALL.bounds) * factor, rtol=1e-6)


def test_a_file_that_contradicts_the_unit(tmp_path: Path) -> None:
    BALL.export(tmp_path / "ball.3mf")
    with pytest.raises(InputError, match="millimeter, not inch"):
        load_mesh(tmp_path / "ball.3mf", "inch")


@pytest.mark.parametrize(("prefix", "scale"), [(".MILLI.", 1.0), (".CENTI.", 10.0), ("$", 1000.0)])
def test_step_files_become_closed_meshes_in_their_own_unit(prefix: str, scale: float, tmp_path: Path) -> None:
    """A cylinder of radius 5 and height 20 in the unit of the file."""
    path = tmp_path / "cylinder.step"
    path.write_text((DATA / "cylinder.step").read_text().replace("SI_UNIT(.MILLI.", f"SI_UNIT({prefix}"))
    mesh = load_mesh(path, "mm")
    assert mesh.volume == pytest.approx(np.pi * 25 * 20 * scale**3, rel=1e-4)
    np.testing.assert_allclose(mesh.bounds[1] / scale, [5, 5, 20], rtol=1e-3)
    with pytest.raises(InputError, match=r"cylinder\.step: a STEP file states its unit itself and is read in mm"):
        load_mesh(path, "inch")


def test_trimesh_is_imported_for_files_only() -> None:
    program = (
        "import sys, numpy as np\nfrom phantomgen.shapes import Mesh, load_mesh\n"
        "Mesh(np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3]]).volume\n"
        "print('trimesh' in sys.modules)\nimport phantomgen.simulation.run\nprint('trimesh' in sys.modules)"
    )
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, encoding="utf-8").stdout
    assert said.split() == ["False", "False"]


@pytest.mark.parametrize(
    ("name", "content", "unit", "message"),
    [
        ("a.step", b"garbage", "mm", "cannot be read as STEP: it holds no solid"),
        ("a.stl", None, "mm", "no such file"),
        ("a.stl", b"solid", "furlong", "one of mm, cm, m, um, inch, got 'furlong'"),
        ("a.iges", b"", "mm", "must be one of .stl"),
        ("a.glb", b"not a mesh at all", "mm", "cannot be read as GLB"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
         b"end_header\n0 0 0\n", "mm", "holds no triangles"),
        ("a.obj", b"v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "mm", "needs the coordinates x, y and z, got 2 of them"),
    ],
)  # fmt: skip
def test_files_that_are_refused(name: str, content: bytes | None, unit: str, message: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_mesh(tmp_path / name, unit)


def test_volume_bounds_and_points_of_a_box() -> None:
    box = Box((1, -1, 0.5), (2, 4, 3))
    source = trimesh.creation.box((2, 4, 3))
    mesh = Mesh(np.array(source.vertices) + box.center, np.array(source.faces))
    assert mesh.volume == pytest.approx(box.volume)
    np.testing.assert_array_equal(mesh.bounds, box.bounds)
    points = np.stack(np.meshgrid(*[np.linspace(-4, 4, 17)] * 3), axis=-1).reshape(-1, 3)
    np.testing.assert_array_equal(mesh.contains(points), box.contains(points))
    assert mesh.contains(points).sum() == 4 * 8 * 6


def test_points_of_a_ball() -> None:
    points = np.random.default_rng(0).normal(size=(20_000, 3)) * 15
    distance = np.linalg.norm(points, axis=1)
    clear = abs(distance - 19.8) > 0.6
    np.testing.assert_array_equal(mesh_of(BALL).contains(points)[clear], (distance < 19.8)[clear])


def test_a_cavity_and_a_body_in_it() -> None:
    cavity, core = BALL.copy(), BALL.copy()
    cavity.apply_scale(0.5)
    cavity.invert()
    core.apply_scale(0.25)
    mesh = mesh_of(joined(BALL, cavity, core))
    assert mesh.volume == pytest.approx(BALL.volume * (1 - 1 / 8 + 1 / 64))
    assert mesh.contains(np.array([[15.0, 0, 0], [7, 0, 0], [1, 0, 0]])).tolist() == [True, False, True]


def test_faces_without_area_close_a_surface() -> None:
    # A tetrahedron whose edge 1-2 has a vertex in the middle on one side only; a face without area fills the gap.
    vertices = np.array([[0, 0, 0], [2.0, 0, 0], [0, 2, 0], [0, 0, 2], [1, 1, 0]])
    faces = np.array([[0, 2, 4], [0, 4, 1], [0, 3, 2], [0, 1, 3], [1, 2, 3], [1, 4, 2]])
    assert Mesh(vertices, faces).volume == pytest.approx(8 / 6)


@pytest.mark.wrong_types
def test_surfaces_that_are_refused() -> None:
    vertices, faces = np.array(BALL.vertices), np.array(BALL.faces)

    def refused(changed: np.ndarray, message: str, points: np.ndarray = vertices) -> None:
        with pytest.raises(InputError, match=f"^bone.stl: .*{message}"):
            Mesh(points, changed, "bone.stl")

    refused(faces[1:], "not closed: 3 faces end at one of 3 open edges; .*fill_holes")
    refused(faces[:, ::-1], "320 faces of 1 of 1 bodies are inside out.*invert")
    refused(np.concatenate([faces[:1, ::-1], faces[1:]]), "4 faces disagree .*fix_normals")
    refused(np.concatenate([faces, faces[:2]]), "2 faces repeat another.*unique_faces")
    refused(np.concatenate([faces, [[1, 1, 2]]]), "1 face without three corners.*nondegenerate")
    refused(np.concatenate([faces, faces[:1, [0, 2, 1]]]), "1 face repeat")
    refused(np.array([[0, 1, 2], [0, 2, 1]]), "repeat another")
    refused(faces + (faces == 161), r"0\.\.161, got 0\.\.162")
    refused(faces, "finite", vertices * np.where(np.arange(162) == 7, np.nan, 1)[:, None])
    refused(faces[:0], "needs triangles")
    refused(faces, r"got \(162, 2\)", vertices[:, :2])
    refused(faces * 1.0, "indices, got float64")
    refused(faces, "enclose no volume", vertices * [1, 1, 0])
    inner = joined(BALL, BALL.copy().apply_scale(0.5))
    refused(np.array(inner.faces), "320 faces of 1 of 2 bodies lie within another", np.array(inner.vertices))


def test_bodies_that_share_an_edge_are_refused() -> None:
    near, far = trimesh.creation.box((2, 2, 2)), trimesh.creation.box((2, 2, 2))
    far.apply_translation([2, 2, 0])
    both = joined(near, far)
    both.merge_vertices()
    with pytest.raises(InputError, match="meet at 1 edges that have more than two"):
        mesh_of(both)


@pytest.mark.parametrize("shift", [(1.0, 0, 0), (0.3, 0.4, 0.5), (30.0, 3.0, 3.0)])
def test_bodies_that_cross_are_refused(shift: tuple) -> None:
    moved = BALL.copy()
    moved.apply_translation(shift)
    with pytest.raises(InputError, match=r"[0-9]+ faces .*(cross|within) another.*union"):
        mesh_of(joined(BALL, moved))


def test_boxes_that_overlap_along_common_faces_are_refused() -> None:
    first, second = trimesh.creation.box((2, 2, 2)), trimesh.creation.box((2, 2, 2))
    second.apply_translation([1, 0, 0])
    with pytest.raises(InputError, match=r"faces .*(cross|within) another.*union"):
        mesh_of(joined(first, second))


@pytest.mark.parametrize("side", [*np.eye(3), *-np.eye(3)])
def test_bodies_may_touch(side: np.ndarray) -> None:
    first, second = trimesh.creation.box((2, 2, 2)), trimesh.creation.box((2, 2, 2))
    second.apply_translation(2 * side + 0.5 * np.roll(side, 1))
    assert mesh_of(joined(first, second)).volume == pytest.approx(16)
    assert mesh_of(joined(second, first)).volume == pytest.approx(16)


def test_a_vertex_pushed_through_the_other_side_is_refused() -> None:
    vertices = np.array(BALL.vertices)
    vertices[5] *= -1.2
    with pytest.raises(InputError, match="cross another one"):
        Mesh(vertices, np.array(BALL.faces))


def test_slender_faces_far_from_the_origin_do_not_cross() -> None:
    screw = trimesh.creation.torus(15.0, 5.0, major_sections=200, minor_sections=7)
    screw.apply_translation([1e5, -2e5, 3e4])
    assert mesh_of(screw).volume == pytest.approx(screw.volume, rel=1e-6)
    large = trimesh.creation.box((1000, 1000, 0.01)).subdivide()
    tip = trimesh.creation.icosphere(4, 1.0)
    tip.apply_translation([300, 200, 1.006])
    assert mesh_of(joined(large, tip)).volume == pytest.approx(large.volume + tip.volume)
    tip.apply_translation([0, 0, -0.002])
    with pytest.raises(InputError, match="faces cross"):
        mesh_of(joined(large, tip))
