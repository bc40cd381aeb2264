"""Path lengths against RTK, where it is installed:

`pip install itk-rtk`. `benchmarks/peers/simulators.py` compares speed, too.
"""

import numpy as np
import pytest

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.ops.trace import trace
from phantomgen.shapes import Ellipsoid, Sphere, solids_of

SIDE, PITCH = 24, 4.0
INNER = ((12.0, -9.0, 7.0), (6.0, 8.0, 5.0))  # centre and half axes


@pytest.mark.filterwarnings("ignore")
def test_nested_ellipsoids_are_those_of_rtk() -> None:
    itk = pytest.importorskip("itk", exc_type=ImportError)
    if not hasattr(itk, "RTK"):
        pytest.skip("itk has no RTK module")
    frames = Geometry.circular(300.0, 500.0, np.array([0.3, 2.0]), Panel(SIDE, SIDE, PITCH)).ray_frames()
    solids = solids_of([(Sphere((0, 0, 0), 25.0), 0), (Ellipsoid(*INNER), 1)])
    found = []
    for source, corner, column, row in frames:
        ways = (corner + np.arange(SIDE)[:, None] * column + np.arange(SIDE)[:, None, None] * row).reshape(-1, 3)
        found.append(trace(np.broadcast_to(source, ways.shape), ways, solids, 2).reshape(SIDE, SIDE, 2))
    wanted = rtk_images(itk, frames)
    assert wanted.max() > 60
    np.testing.assert_allclose(np.array(found) @ [1.0, 3.0], wanted, atol=1e-6 * wanted.max())


def rtk_images(itk, frames: np.ndarray) -> np.ndarray:
    """Line integrals of the sphere, 1/mm, with the ellipsoid of 3/mm in it; densities add up in RTK."""
    image, point, vector = itk.Image[itk.F, 3], itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
    geometry, half = itk.RTK.ThreeDCircularProjectionGeometry.New(), (SIDE - 1) / 2
    for source, corner, column, row in frames:
        panel = source + corner + half * (column + row)
        steps = vector(list(column / PITCH)), vector(list(row / PITCH))
        assert geometry.AddProjection(point(list(source)), point(list(panel)), *steps)
    blank = itk.RTK.ConstantImageSource[image].New()
    blank.SetOrigin([-half * PITCH, -half * PITCH, 0.0])
    blank.SetSpacing([PITCH, PITCH, 1.0])
    blank.SetSize([SIDE, SIDE, len(frames)])
    phantom = itk.RTK.GeometricPhantom.New()
    for center, radii, density in (((0.0, 0.0, 0.0), (25.0, 25.0, 25.0), 1.0), (*INNER, 2.0)):
        shape = itk.RTK.QuadricShape.New()
        shape.SetEllipsoid(point(list(center)), vector(list(radii)), 0.0)
        shape.SetDensity(density)
        phantom.AddConvexShape(shape)
    projected = itk.RTK.ProjectGeometricPhantomImageFilter[image, image].New()
    projected.SetInput(blank.GetOutput())
    projected.SetGeometry(geometry)
    projected.SetGeometricPhantom(phantom)
    projected.SetConfigFile("")
    projected.Update()
    return itk.array_from_image(projected.GetOutput()).astype(np.float64)
