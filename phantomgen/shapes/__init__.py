"""Regions of space with exact surfaces; nothing here knows about materials or energies."""

from phantomgen.geometry.rotation import rotation_matrix
from phantomgen.shapes.ball import Ellipsoid, Sphere
from phantomgen.shapes.base import Part, Primitive, Shape
from phantomgen.shapes.boolean import Difference, HalfSpace, Intersection, Placed, Union
from phantomgen.shapes.box import Box
from phantomgen.shapes.cone import Cone
from phantomgen.shapes.cylinder import Capsule, Cylinder, Tube
from phantomgen.shapes.meshes.mesh import Mesh, is_cad, load_mesh
from phantomgen.shapes.meshes.sweep import sweep
from phantomgen.shapes.operator_arrays import solids_of
from phantomgen.shapes.polygon import Polygon
from phantomgen.shapes.torus import Torus
from phantomgen.shapes.voxels import Voxels

__all__ = [
    "Box",
    "Capsule",
    "Cone",
    "Cylinder",
    "Difference",
    "Ellipsoid",
    "HalfSpace",
    "Intersection",
    "Mesh",
    "Part",
    "Placed",
    "Polygon",
    "Primitive",
    "Shape",
    "Sphere",
    "Torus",
    "Tube",
    "Union",
    "Voxels",
    "is_cad",
    "load_mesh",
    "rotation_matrix",
    "solids_of",
    "sweep",
]
