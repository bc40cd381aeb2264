"""Other programs behind one interface, each in a process of its own; `peers.py` starts it as

    PYTHON benchmarks/peers/engines.py NAME THREADS SOCKET

Packages, all from the Python index: itk-rtk; gvxr (needs the system's libxcb-res, -composite, -ewmh, -icccm, -keysyms
and -xinerama, and an EGL such as Mesa's); trimesh with embreex; open3d (needs libusb-1.0). No others but numpy.

An engine has ``load(case)``, ``run()`` that gives line integrals (view, row, column), and ``frames()``, the rays that
the program itself says it takes.
"""

import contextlib
import sys
import time
from importlib import import_module
from importlib.metadata import version
from multiprocessing.connection import Client

import numpy as np
from scenes import BALL, Case, Solid


def all_rays(frame: np.ndarray, side: int) -> np.ndarray:
    """Vectors from the source to all pixels (row, column, 3)."""
    at = np.arange(side)[:, None]
    return frame[1] + at * frame[2] + at[:, None] * frame[3]


def holds(solid: Solid, point: np.ndarray) -> bool:
    """Whether a point lies in a solid."""
    local = np.linalg.solve(solid.axes, point - solid.center)
    if solid.kind == BALL:
        return bool(local @ local < 1)
    return bool(local[:2] @ local[:2] < 1 and abs(local[2]) < 1)


class Rtk:
    """RTK: quadrics with clip planes, one filter per shape; Joseph's method for voxels.

    Shapes add up. As RTK's reader of FORBILD files does, each gets the difference to what lies at its centre.
    """

    def __init__(self, threads: int) -> None:
        itk = import_module("itk")
        self.itk, self.rtk, self.image = itk, itk.RTK, itk.Image[itk.F, 3]
        itk.MultiThreaderBase.SetGlobalMaximumNumberOfThreads(threads)
        itk.MultiThreaderBase.SetGlobalDefaultNumberOfThreads(threads)
        self.version = f"RTK {version('itk-rtk')}"

    def load(self, case: Case) -> None:
        itk, rtk, image = self.itk, self.rtk, self.image
        point, vector = itk.Point[itk.D, 3], itk.Vector[itk.D, 3]
        self.case, self.geometry = case, rtk.ThreeDCircularProjectionGeometry.New()
        pitch, half = float(np.linalg.norm(case.frames[0, 2])), (case.side - 1) / 2
        for source, corner, column, row in case.frames:
            panel = source + corner + half * (column + row)
            vectors = (vector(list(column / pitch)), vector(list(row / pitch)))
            if not self.geometry.AddProjection(point(list(source)), point(list(panel)), *vectors):
                raise ValueError("RTK refuses a projection")
        self.blank = rtk.ConstantImageSource[image].New()
        self.blank.SetOrigin([-half * pitch, -half * pitch, 0.0])
        self.blank.SetSpacing([pitch, pitch, 1.0])
        self.blank.SetSize([case.side, case.side, len(case.frames)])
        self.blank.SetConstant(0.0)
        self.pitch, self.half = pitch, half
        if case.volume is not None:
            self.filter = rtk.JosephForwardProjectionImageFilter[image, image].New()
            self.volume = itk.image_from_array(np.ascontiguousarray(case.volume, dtype=np.float32))
            self.volume.SetSpacing([case.spacing] * 3)
            self.volume.SetOrigin([-(n - 1) / 2 * case.spacing for n in case.volume.shape[::-1]])
            self.filter.SetInput(1, self.volume)
        else:
            self.filter = rtk.ProjectGeometricPhantomImageFilter[image, image].New()
            self.filter.SetGeometricPhantom(self._phantom(case.solids))
            self.filter.SetConfigFile("")
        self.filter.SetInput(0, self.blank.GetOutput())
        self.filter.SetGeometry(self.geometry)

    def _phantom(self, solids: tuple[Solid, ...]):
        phantom = self.rtk.GeometricPhantom.New()
        for i, solid in enumerate(solids):
            below = [s.mu for s in solids[:i] if holds(s, solid.center)]
            phantom.AddConvexShape(self._quadric(solid, solid.mu - (below[-1] if below else 0.0)))
        return phantom

    def _quadric(self, solid: Solid, density: float):
        shape, inverse = self.rtk.QuadricShape.New(), np.linalg.inv(solid.axes)
        kept = np.diag([1.0, 1.0, 1.0 if solid.kind == BALL else 0.0])
        matrix, center = inverse.T @ kept @ inverse, solid.center
        linear, rest = -2 * matrix @ center, center @ matrix @ center - 1
        terms = [*np.diag(matrix), 2 * matrix[0, 1], 2 * matrix[0, 2], 2 * matrix[1, 2], *linear, rest]
        for name, value in zip("ABCDEFGHIJ", terms, strict=True):
            getattr(shape, f"Set{name}")(float(value))
        if solid.kind != BALL:
            for sign in (1, -1):
                axis, length = sign * solid.axes[:, 2], np.linalg.norm(solid.axes[:, 2])
                place = float(axis @ center / length + length)
                shape.AddClipPlane(self.itk.Vector[self.itk.D, 3](list(axis / length)), place)
        shape.SetDensity(float(density))
        return shape

    def frames(self) -> np.ndarray:
        found = []
        for i in range(len(self.case.frames)):
            source = np.array(list(self.geometry.GetSourcePosition(i)))[:3]
            matrix = self.itk.array_from_matrix(self.geometry.GetProjectionCoordinatesToFixedSystemMatrix(i))
            corner = matrix[:3] @ [-self.half * self.pitch, -self.half * self.pitch, 0, 1] - source
            found.append([source, corner, matrix[:3, 0] * self.pitch, matrix[:3, 1] * self.pitch])
        return np.array(found)

    def run(self) -> np.ndarray:
        self.filter.Modified()
        self.filter.Update()
        return self.itk.array_view_from_image(self.filter.GetOutput())


class Gvxr:
    """gVXR: meshes rasterized by OpenGL, here Mesa's software; lengths per mesh, or energy behind several."""

    def __init__(self, threads: int) -> None:
        self.gvxr = gvxr = import_module("gvxrPython3").gvxr
        gvxr.createNewContext("EGL", 0)
        self.version = f"gVXR {version('gvxr')}, {gvxr.getOpenGlRenderer()}"

    def load(self, case: Case) -> None:
        g = self.gvxr
        g.removePolygonMeshesFromXRayRenderer()
        g.removePolygonMeshesFromSceneGraph()
        pitch = float(np.linalg.norm(case.frames[0, 2]))
        g.setDetectorNumberOfPixels(case.side, case.side)
        g.setDetectorPixelSize(pitch, pitch, "mm")
        g.setMonoChromatic(1.0, "MeV", 1)
        g.usePointSource()
        self.case = case
        self._pose(case.frames[0])  # without it, the first mesh gives an empty image for good
        for i, mesh in enumerate(case.meshes):
            name = f"mesh{i}"
            g.makeTriangularMesh(name, mesh.vertices.ravel().tolist(), mesh.triangles.ravel().tolist(), "mm")
            g.setLinearAttenuationCoefficient(name, 10 * mesh.mu, "cm-1")
            (g.addPolygonMeshAsOuterSurface if i == 0 else g.addPolygonMeshAsInnerSurface)(name)

    def frames(self) -> np.ndarray:
        return self.case.frames

    def run(self) -> np.ndarray:
        found = []
        for frame in self.case.frames:
            self._pose(frame)
            found.append(self._image())
        return np.array(found)

    def _pose(self, frame: np.ndarray) -> None:
        g, (source, corner, column, row) = self.gvxr, frame
        panel = source + corner + (self.case.side - 1) / 2 * (column + row)
        g.setSourcePosition(*source, "mm")
        g.setDetectorPosition(*panel, "mm")
        g.setDetectorUpVector(*(-row / np.linalg.norm(row)))
        g.setDetectorRightVector(*(column / np.linalg.norm(column)))

    def _image(self) -> np.ndarray:
        """A single mesh gives its length, which is in cm; several give the energy behind them. Row 0 is below."""
        if len(self.case.meshes) == 1:
            return 10 * self.case.meshes[0].mu * np.array(self.gvxr.computeLBuffer("mesh0"))[::-1]
        return -np.log(np.array(self.gvxr.computeXRayImage()))[::-1]


class Embree:
    """Embree through trimesh: all hits, met again with planes in float64; lengths from them are ours. One thread."""

    def __init__(self, threads: int) -> None:
        self.trimesh = import_module("trimesh")
        self.intersector = import_module("trimesh.ray.ray_pyembree").RayMeshIntersector
        self.version = f"Embree {version('embreex')}, by trimesh {version('trimesh')}, on one thread"

    def load(self, case: Case) -> None:
        self.case, mesh = case, case.meshes[0]
        self.mesh = self.trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
        self.rays = self.intersector(self.mesh)
        self.normals, self.mu = np.array(self.mesh.face_normals), mesh.mu

    def frames(self) -> np.ndarray:
        return self.case.frames

    def run(self) -> np.ndarray:
        found = []
        for frame in self.case.frames:
            ways = all_rays(frame, self.case.side).reshape(-1, 3)
            reach = np.linalg.norm(ways, axis=1)
            ways /= reach[:, None]
            starts = np.broadcast_to(frame[0], ways.shape)
            faces, rays, places = self.rays.intersects_id(starts, ways, multiple_hits=True, return_locations=True)
            hit = ways[rays]
            out = np.sign(np.einsum("ij,ij->i", hit, self.normals[faces]))
            length = np.minimum(np.einsum("ij,ij->i", hit, places - frame[0]), reach[rays])
            found.append(self.mu * np.bincount(rays, out * length, len(ways)).reshape(2 * (self.case.side,)))
        return np.array(found)


class Open3d:
    """Open3D's RaycastingScene, all hits; lengths from them are ours."""

    def __init__(self, threads: int) -> None:
        self.o3d, self.threads = import_module("open3d"), threads
        self.version = f"Open3D {version('open3d')}"

    def load(self, case: Case) -> None:
        self.case, mesh, core = case, case.meshes[0], self.o3d.core
        self.scene = self.o3d.t.geometry.RaycastingScene(nthreads=self.threads)
        corners = core.Tensor(mesh.vertices.astype(np.float32))
        self.scene.add_triangles(corners, core.Tensor(mesh.triangles.astype(np.uint32)))
        p, q, r = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
        self.normals, self.mu = np.cross(q - p, r - p).astype(np.float32), mesh.mu

    def frames(self) -> np.ndarray:
        return self.case.frames

    def run(self) -> np.ndarray:
        found = []
        for frame in self.case.frames:
            ways = all_rays(frame, self.case.side).reshape(-1, 3)
            reach = np.linalg.norm(ways, axis=1)
            ways = (ways / reach[:, None]).astype(np.float32)
            rays = np.concatenate([np.broadcast_to(frame[0].astype(np.float32), ways.shape), ways], axis=1)
            hits = self.scene.list_intersections(self.o3d.core.Tensor(rays), nthreads=self.threads)
            ray, face, t = (hits[key].numpy() for key in ("ray_ids", "primitive_ids", "t_hit"))
            out = np.sign(np.einsum("ij,ij->i", ways[ray], self.normals[face]))
            found.append(
                self.mu * np.bincount(ray, out * np.minimum(t, reach[ray]), len(ways)).reshape(2 * (self.case.side,))
            )
        return np.array(found)


ENGINES = {"RTK": Rtk, "gVXR": Gvxr, "Embree": Embree, "Open3D": Open3d}


def serve(name: str, threads: int, address: str) -> None:
    """Answer requests until the other side hangs up: a case is loaded, None runs it."""
    with Client(address) as other, contextlib.suppress(EOFError):
        try:
            engine = ENGINES[name](threads)
        except Exception as error:
            other.send(("cannot run", f"{type(error).__name__}: {error}"))
            return
        other.send(("ready", engine.version))
        while True:
            case = other.recv()
            if case is not None:
                engine.load(case)
                other.send(engine.frames())
                continue
            begin = time.perf_counter()
            images = engine.run()
            took = time.perf_counter() - begin
            other.send((took / len(images), np.array(images)))


if __name__ == "__main__":
    serve(sys.argv[1], int(sys.argv[2]), sys.argv[3])
