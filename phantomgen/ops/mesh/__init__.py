"""Rays through closed triangle meshes.

A view, a source with a panel or parallel lines with their feet on a plane, is a projective grid: vertices are projected
once, each cell of the grid (a pixel, a voxel column) lists the triangles that rays through it may meet, and a rule that
gives each edge to exactly one side (`phantomgen.ops.mesh.cpu`) finds an even number of crossings on every line, through
vertices and along faces too. Surfaces must be closed and must not cross themselves; `phantomgen.shapes.meshes.mesh`
checks.
"""

from phantomgen.ops.mesh.edges import CREASE, PLAIN, SILHOUETTE
from phantomgen.ops.mesh.rays import enclosures, mesh_crossings, mesh_intervals, mesh_lengths, overlaps
from phantomgen.ops.mesh.views import MeshView, Surfaces, mesh_view

__all__ = [
    "CREASE",
    "PLAIN",
    "SILHOUETTE",
    "MeshView",
    "Surfaces",
    "enclosures",
    "mesh_crossings",
    "mesh_intervals",
    "mesh_lengths",
    "mesh_view",
    "overlaps",
]
