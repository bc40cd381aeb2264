"""Scenes that `peers.py` hands to this program and to its peers: numbers only, so that every interpreter can read them.

A view is a frame as `Geometry.ray_frames` gives it: rays run from ``frame[0]``, t = 0, by ``frame[1] + column frame[2]
+ row frame[3]``, t = 1, through the centre of each pixel [mm].
"""

from dataclasses import dataclass, replace

import numpy as np

BALL, CYLINDER = 0, 1
SOD, SDD, PITCH, SIDE = 500.0, 1000.0, 1.0, 256
VIEWS = 8


@dataclass(frozen=True)
class Solid:
    """An affine image of the unit ball, or of the unit cylinder |z| <= 1; half axes as columns [mm], mu in 1/mm."""

    kind: int
    center: np.ndarray
    axes: np.ndarray
    mu: float


@dataclass(frozen=True)
class Mesh:
    """A closed triangle mesh, counter-clockwise seen from outside [mm], and its mu in 1/mm."""

    vertices: np.ndarray
    triangles: np.ndarray
    mu: float = 1.0


@dataclass(frozen=True)
class Case:
    """What is projected: solids or meshes in painter's order, or voxels (z, y, x) about the origin [mm]."""

    name: str
    frames: np.ndarray
    solids: tuple[Solid, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    volume: np.ndarray | None = None
    spacing: float = 1.0
    side: int = SIDE
    mean_of: int = 1  # so many rays along each edge of a pixel, over which the truth is averaged
    as_one: bool = False  # whether its solids are one closed mesh, those of mu = 0 holes in it


def circle(views: int = VIEWS, side: int = SIDE, pitch: float = PITCH, sod: float = SOD, sdd: float = SDD):
    """Frames of a circular orbit; row 0 is on top, and no ray runs along an axis."""
    angle = 0.1 + 2 * np.pi * np.arange(views) / views
    zero = np.zeros(views)
    out = np.stack([np.cos(angle), np.sin(angle), zero], axis=1)
    column, row = pitch * np.stack([-np.sin(angle), np.cos(angle), zero], axis=1), np.tile([0, 0, -pitch], (views, 1))
    corner = -sdd * out - (side - 1) / 2 * (column + row)
    return np.stack([sod * out, corner, column, row], axis=1)


def ball(center, radii, mu: float, turn: float = 0.0) -> Solid:
    """An ellipsoid, turned about z [degree]."""
    c, s = np.cos(np.deg2rad(turn)), np.sin(np.deg2rad(turn))
    axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) * np.broadcast_to(np.asarray(radii, dtype=float), 3)
    return Solid(BALL, np.array(center, dtype=float), axes, mu)


def cylinder(center, radius: float, length: float, mu: float) -> Solid:
    """A cylinder along z."""
    return Solid(CYLINDER, np.array(center, dtype=float), np.diag([radius, radius, length / 2]), mu)


def four() -> Case:
    """Soft tissue with bone, a K-edge cylinder and an ellipsoid, strictly nested."""
    solids = (
        cylinder((0, 0, 0), 50.0, 100.0, 0.02),
        cylinder((20, 0, 0), 12.0, 80.0, 0.05),
        cylinder((-15, 18, 5), 10.0, 60.0, 0.04),
        ball((0, -22, 0), (15.0, 8.0, 20.0), 0.01, turn=30.0),
    )
    return Case("4 solids", circle(), solids)


def foam(count: int, radius: float, views: int = VIEWS) -> Case:
    """A cylinder with so many spheres in it that do not touch."""
    rng, found = np.random.default_rng(7), np.empty((0, 3))
    while len(found) < count:
        place = rng.uniform(-1, 1, 3) * (48 - radius)
        apart = len(found) == 0 or np.linalg.norm(found - place, axis=1).min() > 2.02 * radius
        if apart and np.hypot(*place[:2]) < 49 - radius:
            found = np.vstack([found, place])
    spheres = tuple(
        ball(place, radius, mu) for place, mu in zip(found, rng.choice([0.0, 0.01, 0.03, 0.06], count), strict=True)
    )
    return Case(f"{count + 1} solids", circle(views), (cylinder((0, 0, 0), 50.0, 100.0, 0.02), *spheres))


def octasphere(parts: int, radius: float, center=(0.0, 0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Octahedron with each edge cut in `parts`, blown up to a sphere: 8 parts^2 triangles."""
    i, j = np.array([(i, j) for i in range(parts + 1) for j in range(parts + 1 - i)]).T
    number = np.full((parts + 2, parts + 2), -1)
    number[i, j] = np.arange(len(i))
    up = np.stack([number[i, j], number[i + 1, j], number[i, j + 1]], axis=1)[i + j < parts]
    down = np.stack([number[i + 1, j], number[i + 1, j + 1], number[i, j + 1]], axis=1)[i + j < parts - 1]
    corner, face = np.stack([i, j, parts - i - j], axis=1), np.concatenate([up, down])
    corners, faces = [], []
    for signs in np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, 8).T:
        faces.append((face if signs.prod() > 0 else face[:, ::-1]) + len(corner) * len(corners))
        corners.append(corner * signs)
    vertices, place = np.unique(np.concatenate(corners), axis=0, return_inverse=True)
    vertices = radius * vertices / np.linalg.norm(vertices, axis=1, keepdims=True) + np.asarray(center)
    return vertices, place.reshape(-1)[np.concatenate(faces)]


def prism(sides: int, radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """A cylinder along z as CAD programs write it: quadrilaterals cut in two, caps as fans; 4 sides - 4 triangles."""
    angle = 2 * np.pi * np.arange(sides) / sides
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    vertices = np.concatenate([np.column_stack([ring, np.full(sides, z)]) for z in (-length / 2, length / 2)])
    i = np.arange(sides)
    j, fan = (i + 1) % sides, np.arange(1, sides - 1)
    walls = np.concatenate([np.stack([i, j, sides + j], axis=1), np.stack([i, sides + j, sides + i], axis=1)])
    top = np.stack([np.full(sides - 2, sides), sides + fan, sides + fan + 1], axis=1)
    bottom = np.stack([np.zeros(sides - 2, int), fan + 1, fan], axis=1)
    return vertices, np.concatenate([walls, top, bottom])


def mesh_case(vertices: np.ndarray, triangles: np.ndarray) -> Case:
    """One mesh of mu = 1/mm, so that images are lengths."""
    return Case(f"{len(triangles)} triangles", circle(), meshes=(Mesh(vertices, triangles),))


def scaled(case: Case, factor: float) -> Case:
    """The same scene with lengths in another unit: line integrals stay what they were."""
    solids = tuple(replace(s, center=s.center * factor, axes=s.axes * factor, mu=s.mu / factor) for s in case.solids)
    meshes = tuple(replace(m, vertices=m.vertices * factor, mu=m.mu / factor) for m in case.meshes)
    return replace(case, frames=case.frames * factor, solids=solids, meshes=meshes)


def hard_cases() -> list[Case]:
    """Balls that are easily got wrong, after an easy case; one view of 64 x 64 pixels."""
    frames = circle(1, 64, 4.0)
    towards = frames[0, 0] / SOD
    middle, inner = ball((0, 0, 0), 50.0, 0.02), ball((5, 0, 0), 20.0, 0.01)
    beyond = (ball(700 * towards, 40.0, 0.02), ball(-700 * towards, 40.0, 0.02))
    nested = (ball((0, 0, 0), 60.0, 0.02), ball((5, 0, 0), 40.0, 0.05), inner, ball((5, 0, 0), 9.0, 0.1))
    overlap = (ball((-8, 0, 0), 30.0, 0.02), ball((20, 5, 3), 25.0, 0.05), ball((5, -18, -4), 20.0, 0.0))
    shell = (ball((0, 0, 0), 50.0, 2000.0), ball((0, 0, 0), 50.0 - 1e-4, 0.0))
    easy = Case("one ball", frames, (ball((10, 0, 8), 30.0, 0.05),), side=64)
    return [
        easy,
        replace(easy, name="partial overlap", solids=overlap),
        replace(easy, name="same surface twice", solids=(middle, replace(middle, mu=0.05))),
        replace(easy, name="nested four deep", solids=nested),
        replace(easy, name="source inside", solids=(ball(480 * towards, 100.0, 0.01),)),
        replace(easy, name="behind source and panel", solids=beyond, as_one=True),
        replace(scaled(easy, 1e3), name="lengths in um"),
        replace(scaled(easy, 1e6), name="lengths in nm"),
        replace(easy, name="shell of 1e-4 mm", solids=shell, as_one=True),
    ]


def meshed(case: Case, parts: int = 12) -> Case:
    """Balls replaced by octaspheres of 8 parts^2 triangles."""
    vertices, triangles = octasphere(parts, 1.0)
    meshes = [Mesh(vertices @ s.axes.T + s.center, triangles, s.mu) for s in case.solids]
    if case.as_one:
        corners = np.concatenate([mesh.vertices for mesh in meshes])
        faces = [(t.triangles if t.mu else t.triangles[:, ::-1]) + i * len(vertices) for i, t in enumerate(meshes)]
        meshes = [Mesh(corners, np.concatenate(faces), case.solids[0].mu)]
    return replace(case, solids=(), meshes=tuple(meshes))
