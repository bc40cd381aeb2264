"""Regions of space with exact surfaces; nothing here knows about materials or energies."""

from phantomgen.shapes.arrays import ShapeArrays
from phantomgen.shapes.ball import Ellipsoid, Sphere
from phantomgen.shapes.base import Shape, rotation_matrix
from phantomgen.shapes.box import Box
from phantomgen.shapes.cylinder import Cylinder
from phantomgen.shapes.mesh import Mesh, load_mesh

__all__ = ["Box", "Cylinder", "Ellipsoid", "Mesh", "Shape", "ShapeArrays", "Sphere", "load_mesh", "rotation_matrix"]
