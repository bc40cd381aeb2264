"""Closed triangle meshes."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64

from phantomgen.shapes.base import Shape, Term, mesh_part
from phantomgen.shapes.meshes.validity import check_surface
from spectra.errors import InputError, NotInstalledError

UNITS = {"mm": 1.0, "cm": 10.0, "m": 1000.0, "um": 1e-3, "inch": 25.4}
# What 3MF files say of their own coordinates.
_DECLARED = {"micron": "um", "millimeter": "mm", "centimeter": "cm", "inch": "inch", "meter": "m"}
FORMATS = (".stl", ".obj", ".ply", ".glb", ".3mf", ".step", ".stp")
# CAD surfaces become triangles whose normals differ by less than this [rad] and whose edges bend by less than this part
# of their length: a cylinder loses 4e-5 of its volume.
_CAD_ANGLE, _CAD_BEND = 0.03, 1e-3


@dataclass(frozen=True, eq=False)
class Mesh(Shape):
    """Space inside a closed surface of triangles.

    Parameters
    ----------
    vertices : corners (x, y, z) [mm]
    triangles : indices of vertices, counter-clockwise seen from outside
    name : what error messages call it

    Raises
    ------
    InputError
        When the surface has holes, faces that are duplicate, without corners of their own or turned over, when it is
        turned inside out, or when it pierces itself. Faces without area are fine where the surface needs them to be
        closed; faces that overlap within a plane, or touch, are not noticed.
    """

    vertices: Float[np.ndarray, "vertex 3"]
    triangles: Int64[np.ndarray, "triangle 3"]
    name: str = "mesh"

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices", np.ascontiguousarray(self.vertices, dtype=np.float64))
        triangles = np.asarray(self.triangles)
        if triangles.dtype.kind not in "iu":
            raise InputError(f"{self.name}: triangles must be indices, got {triangles.dtype}")
        object.__setattr__(self, "triangles", np.ascontiguousarray(triangles, dtype=np.int64))
        check_surface(self.vertices, self.triangles, self.name)

    def __repr__(self) -> str:
        return f"Mesh({self.name}: {len(self.triangles)} triangles)"

    @property
    def terms(self) -> tuple[Term, ...]:
        """One term of one part."""
        return ((mesh_part(self.vertices, self.triangles),),)

    @property
    def volume(self) -> float:
        """Volume [mm^3]."""
        p, q, r = (self.vertices - self.vertices.mean(axis=0))[self.triangles.T]
        return float(np.einsum("ki,ki->", p, np.cross(q, r))) / 6


def is_cad(path: str | Path) -> bool:
    """Return whether a file contains smooth surfaces, which become triangles.

    Parameters
    ----------
    path : the file

    Returns
    -------
    True for STEP files
    """
    return Path(path).suffix.lower() in {".step", ".stp"}


def load_mesh(path: str | Path, unit: str, name: str | None = None, fineness: int = 1) -> Mesh:
    """Read a mesh from a file; corners with exactly equal coordinates become one vertex.

    Parameters
    ----------
    path : an STL, OBJ, PLY, GLB, 3MF or STEP file; the bodies of a file with several are one mesh
    unit : of the file's coordinates, one of mm, cm, m, um, inch; a STEP file states its own and is read in mm
    name : what error messages call it; the file's name unless given
    fineness : triangles of CAD surfaces are so many times finer than usual

    Returns
    -------
    the mesh

    Raises
    ------
    InputError
        When the file cannot be read, or the unit is unknown.
    """
    path = Path(path)
    if unit not in UNITS:
        raise InputError(f"{path.name}: unit of a mesh must be one of {', '.join(UNITS)}, got {unit!r}")
    if path.suffix.lower() not in FORMATS:
        raise InputError(f"{path}: a mesh must be one of {', '.join(FORMATS)}")
    if not path.is_file():
        raise InputError(f"{path}: there is no such file")
    vertices, triangles, declared = _read(path, fineness)
    if is_cad(path):
        if unit != "mm":
            raise InputError(f"{path}: a STEP file states its unit itself and is read in mm: write mm, not {unit}")
        unit = "m"  # what its reader converts to
    if path.suffix.lower() == ".3mf" and _DECLARED.get(declared, declared) != unit:
        raise InputError(f"{path}: the file says that its unit is {declared}, not {unit}")
    if not len(triangles):
        raise InputError(f"{path}: the file holds no triangles")
    if vertices.shape[1:] != (3,):
        raise InputError(f"{path}: a corner needs the coordinates x, y and z, got {vertices.shape[-1]} of them")
    if not 0 <= triangles.min() <= triangles.max() < len(vertices):
        found = f"0 to {len(vertices) - 1}, got {triangles.min()} to {triangles.max()}"
        raise InputError(f"{path}: indices of corners must lie in {found}")
    return Mesh(*merge_equal(vertices * UNITS[unit], triangles), name=name or path.name)


def merge_equal(
    vertices: Float[np.ndarray, "vertex 3"], triangles: Int64[np.ndarray, "triangle 3"]
) -> tuple[Float[np.ndarray, "distinct 3"], Int64[np.ndarray, "triangle 3"]]:
    """Merge vertices at equal points.

    Parameters
    ----------
    vertices : (x, y, z) [mm], (vertex, 3)
    triangles : indices of vertices, (triangle, 3)

    Returns
    -------
    distinct vertices, and triangles with their indices
    """
    order = np.lexsort(vertices.T)
    points = vertices[order]
    first = np.ones(len(points), dtype=np.bool_)
    first[1:] = (points[1:] != points[:-1]).any(axis=1)
    rank = np.empty(len(points), dtype=np.int64)
    rank[order] = np.cumsum(first) - 1
    return points[first], rank[triangles]


def _read(path: Path, fineness: int) -> tuple[np.ndarray, np.ndarray, str]:
    """Vertices, triangles, and the unit that the file gives for itself, if any."""
    try:
        import trimesh  # noqa: PLC0415 - only where there is a mesh

        bends = {"tol_angular": _CAD_ANGLE / fineness, "tol_linear": _CAD_BEND / fineness**2, "tol_relative": True}
        loaded = trimesh.load_mesh(path, process=False, **(bends if is_cad(path) else {}))
    except ImportError as error:
        raise NotInstalledError(f"{path}: reading this file needs a module: pip install {error.name}") from error
    except Exception as error:
        kind = path.suffix[1:].upper()
        reason = "it holds no solid" if isinstance(error, FileNotFoundError) else error  # of what a STEP file becomes
        raise InputError(f"{path}: the file cannot be read as {kind}: {reason}") from error
    faces = getattr(loaded, "faces", np.empty((0, 3)))
    triangles = np.array(faces, dtype=np.int64).reshape(-1, 3)
    return np.array(loaded.vertices, dtype=np.float64), triangles, (loaded.units or "mm").removesuffix("s")
