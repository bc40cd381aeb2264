"""A CTSimU scenario and the metadata of its projections, as the specification has them: TIFF of counts.

Circles with equal steps are a stage that turns; other orbits are drifts of source and panel that a reconstruction may
know, one value per view.

References
----------
.. [1] https://bamresearch.github.io/ctsimu-scenarios, format 1.2.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import at_equal_output, file_name
from phantomgen.exporters.scans.tiff import write_images
from phantomgen.geometry.conversions.panel_axes import refuse_curved
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

KINDS: tuple[Kind, ...] = ("counts",)
SCRIPT = """
scan, name = load()
with open(f"{scan['files'][name]}_metadata.json", encoding="utf-8") as file:
    projections = json.load(file)["output"]["projections"]
data = np.stack([tifffile.imread(projections["filename"] % view) for view in range(projections["number"])])
print(scan["what"], name, data.shape, "from", data.min(), "to", data.max(), "poses in scenario.json")
"""
IMPORTS = "import tifffile"
_VERSION = {"major": 1, "minor": 2}
# mm, and angles times the distance in mm; views may be so far from a circle with equal steps
_SAME = 1e-9
_AXES = ("x", "y", "z")

Vectors = Float[np.ndarray, "view 3"]


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``scenario.json``, and for each channel a folder of images and its metadata.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    nothing that ``scan.json`` would not say

    Raises
    ------
    GeometryError
        When the beam is parallel, or the panel curved.
    """
    geometry = projections.geometry
    refuse_curved(geometry, "CTSimU")
    if geometry.is_parallel:
        raise GeometryError("scenarios of CTSimU are written for cone beams, and this beam is parallel: take tiff")
    scenario = json.dumps(scenario_of(geometry, projections.title), indent=1)
    (folder / "scenario.json").write_text(scenario, encoding="utf-8")
    projections = at_equal_output(projections)
    write_images(folder, projections)
    for name in projections.names:
        place = folder / f"{file_name(name)}_metadata.json"
        place.write_text(json.dumps(_metadata(projections, file_name(name)), indent=1), encoding="utf-8")
    return {}


def scenario_of(geometry: Geometry, title: str) -> dict[str, Any]:
    """Describe poses as a scenario of CTSimU.

    Parameters
    ----------
    geometry : cone beam with a flat panel
    title : of the scan

    Returns
    -------
    content of the JSON file; all lengths in mm, angles in degrees
    """
    panel, count = geometry.panel, len(geometry)
    turn = _turn_of(geometry)
    shown = geometry if turn is None else geometry[[0]]
    u = shown.column_step / panel.column_pitch
    v = shown.row_step / panel.row_pitch
    beam = shown.panel_center - shown.source
    beam /= np.linalg.norm(beam, axis=1, keepdims=True)
    stage = np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0]]), np.array([[0.0, 0.0, 1.0]])
    angle = 0.0 if turn is None else turn * count
    return {
        "file": {
            "name": title,
            "file_type": "CTSimU Scenario",
            "file_format_version": _VERSION,
            "description": "poses of a scan that was written by phantomgen export",
        },
        "environment": {"material_id": None, "temperature": None},
        "geometry": {
            "detector": _part(shown.panel_center, u, np.cross(u, v)),
            "source": {"type": "cone", **_part(shown.source, _across(beam), beam)},
            "stage": _part(*stage),
        },
        "detector": {
            "model": None,
            "type": "ideal",
            "columns": _value(panel.columns, "px"),
            "rows": _value(panel.rows, "px"),
            "pixel_pitch": {"u": _value(panel.column_pitch, "mm"), "v": _value(panel.row_pitch, "mm")},
        },
        "source": {"model": None, "voltage": None, "spectrum": {"monochromatic": False, "file": None}},
        "samples": None,
        "acquisition": {
            "start_angle": _value(0.0, "deg"),
            "stop_angle": _value(abs(angle), "deg"),
            "direction": "CW" if angle < 0 else "CCW",
            "scan_mode": "stop+go",
            "scan_direction": None,
            "number_of_projections": count,
            "include_final_angle": False,
            "frame_average": 1,
        },
        "materials": [],
    }


def _turn_of(geometry: Geometry) -> float | None:
    """Degrees by which a stage turns from view to view; None where no turning stage gives the same poses."""
    if len(geometry) < 2:
        return None
    angles = np.unwrap(geometry.angles)
    step = (angles[-1] - angles[0]) / (len(angles) - 1)
    turned = step * np.arange(len(angles))
    cosine, sine = np.cos(turned), np.sin(turned)
    far = float(np.linalg.norm(geometry.panel_center - geometry.source, axis=1).max())
    for name in ("source", "panel_center", "column_step", "row_step"):
        first, all_views = getattr(geometry, name)[0], getattr(geometry, name)
        x, y = cosine * first[0] - sine * first[1], sine * first[0] + cosine * first[1]
        wanted = np.stack([x, y, np.full(len(x), first[2])], axis=1)
        if np.abs(all_views - wanted).max() > _SAME * max(far, 1.0):
            return None
    return float(-np.rad2deg(step))  # the sample turns against the scanner


def _part(center: Vectors, u: Vectors, w: Vectors) -> dict[str, Any]:
    """Place and axes of a part of the scanner, in all views."""
    return {
        "center": _vector(center, "mm"),
        "vector_u": _vector(u, None),
        "vector_w": _vector(w, None),
        "deviations": [],
    }


def _vector(values: Vectors, unit: str | None) -> dict[str, Any]:
    """Components of a vector; those that change are drifts from the first view on."""
    found = {}
    for axis, along in zip(_AXES, values.T, strict=True):
        found[axis] = _value(float(along[0]), unit)
        if np.ptp(along) > 0:
            drift = {"value": (along - along[0]).tolist(), "unit": unit, "known_to_reconstruction": True}
            found[axis] |= {"drifts": [drift]}
    return found


def _value(value: float, unit: str | None) -> dict[str, Any]:
    return {"value": value, "unit": unit}


def _across(direction: Vectors) -> Vectors:
    """Unit vectors at right angles to directions."""
    helper = np.where(np.abs(direction[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    across = np.cross(helper, direction)
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def _metadata(projections: Projections, name: str) -> dict[str, Any]:
    """Files of a channel."""
    panel, files = projections.geometry.panel, name.replace("%", "%%") + "/{}_%04d.tif"

    def frames(what: str, images: np.ndarray | None) -> dict[str, Any]:
        number = 0 if images is None else len(images)
        pattern = files.format(what) if number else None
        return {"number": number, "frame_average": 1, "filename": pattern, "projections_corrected": False}

    return {
        "file": {
            "name": f"{projections.title}, {name}",
            "file_type": "CTSimU Metadata",
            "file_format_version": _VERSION,
        },
        "output": {
            "projections": {
                "filename": files.format("view"),
                "number": len(projections),
                "frame_average": 1,
                "datatype": "float32",
                "byteorder": "little",
                "headersize": {"file": 0, "image": 0},
                "dimensions": {"x": _value(panel.columns, "px"), "y": _value(panel.rows, "px")},
                "pixelsize": {"x": _value(panel.column_pitch, "mm"), "y": _value(panel.row_pitch, "mm")},
                "flat_field": frames("flat", projections.flats),
                "dark_field": frames("dark", projections.darks),
            },
            "tomogram": None,
            "reconstruction": None,
        },
        "acquisition_geometry": {"path_to_CTSimU_JSON": "scenario.json"},
    }
