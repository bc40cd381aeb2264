"""All cases of ``phantomgen stress``."""

from phantomgen.stress import counts, energies, rays
from phantomgen.stress.case import Case

_DIAMETER = "error of the path, in diameters"
_LOG = "error of the log projection"

CASES = (
    Case("grazing", "rays that touch a ball", "distance to the surface [radius]", _DIAMETER, 1e-9, rays.grazing),
    Case("axis", "rays along a cylinder", "distance to the wall [mm]", _DIAMETER, 1e-12, rays.along_an_axis),
    Case("corners", "rays through corners of a mesh", "distance to it [mm]", _DIAMETER, 1e-12, rays.corners),
    Case("edges", "rays through edges of a mesh", "distance to the middle [mm]", _DIAMETER, 1e-12, rays.edges),
    Case("coincident", "boxes that share all faces", "boxes", "error of paths, in edges", 1e-12, rays.coincident),
    Case("nested", "balls within balls", "balls", _DIAMETER, 1e-12, rays.nested),
    Case("shells", "walls down to 1e-12 mm", "thickness [mm]", _DIAMETER, 1e-12, rays.thin_shells),
    Case("inside", "a source inside a ball", "depth of the source [mm]", _DIAMETER, 1e-12, rays.source_inside),
    Case("far", "a ball far from the origin", "distance [mm]", _DIAMETER, 1e-8, rays.far_away),
    Case("metal", "absorption over 100 decades", "decades", _LOG, 1e-12, counts.metal),
    Case("starvation", "few photons", "photons per pixel", "error of the mean log [std. err.]", 4.0, counts.starvation),
    Case("voxel", "a ball in a single voxel", "radius [mm]", "error of the part filled", 1e-5, counts.one_voxel),
    Case("flat-voxels", "a ball in flat voxels", "ratio of edges", "relative volume error", 1e-5, counts.flat_voxels),
    Case("threshold", "a threshold near a K edge", "distance [keV]", _LOG, 1e-6, energies.threshold_at_an_edge),
    Case("voltage", "a tube voltage near a K edge", "distance [kV]", _LOG, 1e-6, energies.voltage_at_an_edge),
    Case("two-edges", "two K edges", "distance [keV]", _LOG, 1e-6, energies.two_edges),
)
