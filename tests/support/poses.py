"""Random poses for tests of geometries, drawn by hypothesis."""

import numpy as np
from hypothesis import strategies as st

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.rotation import rotation_matrix

LENGTHS = {"sod": st.floats(50, 900), "behind": st.floats(20, 700), "row_pitch": st.floats(0.05, 3)}
TURNS = st.tuples(*[st.floats(-3.1, 3.1)] * 3)
SHIFTS = st.tuples(*[st.floats(-40, 40)] * 3)


@st.composite
def panels(draw, square=False):
    rows, pitch = draw(st.integers(1, 90)), draw(st.floats(0.05, 3))
    return Panel(
        rows, rows if square else draw(st.integers(1, 90)), (pitch, pitch if square else draw(st.floats(0.05, 3)))
    )


@st.composite
def circles(draw, square=False):
    """Circular scans with a centred upright panel."""
    angles = np.array(draw(st.lists(st.floats(-6, 6), min_size=1, max_size=4)))
    sod, behind = draw(LENGTHS["sod"]), draw(LENGTHS["behind"])
    return Geometry.circular(sod, sod + behind, angles, draw(panels(square)))


@st.composite
def mounted_circles(draw):
    """Circular scans with a panel that is shifted and tilted."""
    tilt = draw(st.tuples(*[st.floats(-0.5, 0.5)] * 3))
    return mounted(draw(circles()), Mount(draw(st.tuples(st.floats(-30, 30), st.floats(-30, 30))), tilt))


@st.composite
def free_poses(draw):
    """Views whose pose is turned and shifted at will, with source and panel on either side of each other."""
    geometry = draw(mounted_circles())
    turns = np.array([rotation_matrix(draw(TURNS)) for _ in range(len(geometry))])
    return geometry.moved(turns, np.array([draw(SHIFTS) for _ in range(len(geometry))]))


@st.composite
def skewed_poses(draw):
    """Views whose columns and rows meet at any angle."""
    geometry = draw(free_poses())
    skew = draw(st.floats(-0.4, 0.4))
    turned = np.cos(skew) * geometry.row_step * geometry.panel.column_pitch / geometry.panel.row_pitch
    row = turned + np.sin(skew) * geometry.column_step
    row *= geometry.panel.row_pitch / np.linalg.norm(row, axis=1, keepdims=True)
    return Geometry(geometry.source, geometry.panel_center, geometry.column_step, row, geometry.panel)


@st.composite
def parallel_poses(draw, slant=False):
    """Parallel beams across the panel, or at a slant."""
    cone = draw(free_poses())
    normal = cone.normals()
    if slant:
        normal = normal + draw(st.floats(-0.3, 0.3)) * cone.column_step / cone.panel.column_pitch
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    center = 300 * normal + draw(st.floats(-30, 30)) * cone.column_step / cone.panel.column_pitch
    return Geometry.parallel(normal, center, cone.column_step, cone.row_step, cone.panel)


def largest_difference(first: Geometry, second: Geometry) -> float:
    """Largest difference of two geometries' vectors [mm], directions of rays in place of far sources."""
    assert (first.panel.rows, first.panel.columns) == (second.panel.rows, second.panel.columns)
    np.testing.assert_allclose(first.panel.pitch, second.panel.pitch, rtol=1e-12)
    assert first.is_parallel == second.is_parallel
    names = ("ray_direction" if first.is_parallel else "source", "panel_center", "column_step", "row_step")
    return max(float(np.abs(getattr(first, n) - getattr(second, n)).max()) for n in names)


def pixel_of(geometry: Geometry, point: np.ndarray, view: int = 0) -> tuple[float, float]:
    """Row and column of the pixel that sees a point."""
    source, first, column, row = geometry.ray_frames()[view]
    scale, u, v = np.linalg.solve(np.stack([np.asarray(point) - source, -column, -row], axis=1), first)
    assert scale > 0
    return float(v), float(u)
