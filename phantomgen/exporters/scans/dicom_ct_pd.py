"""DICOM-CT-PD: one file per view and channel of log projections, circular and helical scans.

The panel is flat, or curved around the focal spot.

Angles are those of the format's manual, where the source of angle phi stands at (-rho sin phi, rho cos phi). The signs
of rows and columns have not been compared with a reader of a vendor.

References
----------
.. [1] Chen et al. 2015, doi:10.1117/12.2070931 (DICOM-CT-PD); Moen et al. 2021, doi:10.1002/mp.14594, table IV.
"""

from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name
from phantomgen.geometry.conversions.panel_axes import refuse_parallel, right_angled_steps
from phantomgen.geometry.curved_panel import shifted_along
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError, NotInstalledError

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
views = [pydicom.dcmread(path) for path in sorted(Path(scan["files"][name]).glob("*.dcm"))]
data = np.array([view.pixel_array * float(view.RescaleSlope) + float(view.RescaleIntercept) for view in views])
phi, z, rho = (np.array([view[0x7031, tag].value for view in views]) for tag in (0x1001, 0x1002, 0x1003))
source = np.stack([-rho * np.sin(phi), rho * np.cos(phi), z], axis=1)  # (x, y, z) [mm]
print("line integrals", data.shape, "from", data.min(), "to", data.max(), "first source", source[0])
"""
IMPORTS = "from pathlib import Path\n\nimport pydicom"
_SAME = 1e-6  # of the distance to the panel; poses may be so far from what the format can describe
_STORAGE = "1.2.840.10008.5.1.4.1.1.66"  # raw data
_STEPS = 65535


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write a folder of files per channel.

    Parameters
    ----------
    folder : that gets the folders
    projections : what to write

    Returns
    -------
    what the script needs to know: nothing

    Raises
    ------
    NotInstalledError
        When pydicom is not there.
    GeometryError
        When the panel is tilted or curved around another point than the focal spot, or the beam is parallel.
    """
    try:
        import_module("pydicom")
    except ImportError:
        raise NotInstalledError("writing DICOM-CT-PD needs pydicom: pip install 'spectral-ct[dicom]'") from None
    tags = poses_as_tags(projections.geometry)
    uid = import_module("pydicom.uid").generate_uid
    names = projections.names
    own = [folder / file_name(name) for name in names]
    series, study = [uid() for _ in own], uid()
    for place in own:
        place.mkdir()
    for view in range(len(projections)):
        for number, image in enumerate(projections.image(view)):
            private = {**tags[view], (0x7033, 0x1061): ("US", len(names)), (0x7033, 0x1063): ("US", number + 1)}
            instance = _dataset(image, private, view, f"{projections.title}, {names[number]}"[:64])
            instance.StudyInstanceUID, instance.SeriesInstanceUID, instance.SeriesNumber = (
                study,
                series[number],
                number + 1,
            )
            instance.save_as(own[number] / f"view_{view:05d}.dcm", enforce_file_format=True)
    return {}


def poses_as_tags(geometry: Geometry) -> list[dict[tuple[int, int], tuple[str, Any]]]:
    """Convert poses to private tags of the format.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    per view, (VR, value) by tag

    Raises
    ------
    GeometryError
        When a view cannot be said by the format.
    """
    refuse_parallel(geometry, "DICOM-CT-PD")
    panel, source = geometry.panel, geometry.source
    geometry, along = _facing_axis(geometry)
    column, row = right_angled_steps(geometry, "DICOM-CT-PD")
    rho, phi = np.hypot(source[:, 0], source[:, 1]), np.arctan2(-source[:, 0], source[:, 1])
    zero = np.zeros(len(geometry))
    wanted = np.stack([-np.cos(phi), -np.sin(phi), zero], 1), np.tile([0.0, 0.0, -1.0], (len(geometry), 1))
    apart = np.maximum(*(np.linalg.norm(a - b, axis=1) for a, b in zip((column, row), wanted, strict=True)))
    if apart.max(initial=0) > _SAME:
        raise GeometryError(
            f"DICOM-CT-PD can only describe upright panels across the ray from the source to the axis: that of view "
            f"{apart.argmax()} is turned or tilted ({geometry.kind} geometry)"
        )
    ray = geometry.panel_center - source
    away = np.cross(column, row)
    sdd = np.einsum("vi,vi->v", ray, away)
    shift = [np.einsum("vi,vi->v", ray, axis) for axis in (column, row)]
    shift[0] = shift[0] - along
    facing = [
        (n + 1) / 2 - offset / pitch
        for n, offset, pitch in zip(
            (panel.columns, panel.rows), shift, (panel.column_pitch, panel.row_pitch), strict=True
        )
    ]
    shape = _shape(panel, sdd)
    helical = bool(np.ptp(source[:, 2]) > _SAME * float(sdd.max()))
    return [
        {
            (0x7029, 0x1010): ("US", panel.rows),
            (0x7029, 0x1011): ("US", panel.columns),
            (0x7029, 0x1002): ("FL", panel.column_pitch),
            (0x7029, 0x1006): ("FL", panel.row_pitch),
            (0x7029, 0x100B): ("CS", shape),
            (0x7031, 0x1001): ("FL", float(phi[view])),
            (0x7031, 0x1002): ("FL", float(source[view, 2])),
            (0x7031, 0x1003): ("FL", float(rho[view])),
            (0x7031, 0x1031): ("FL", float(sdd[view])),
            (0x7031, 0x1033): ("FL", [float(facing[0][view]), float(facing[1][view])]),
            (0x7033, 0x100E): ("CS", "FFSNONE"),
            (0x7037, 0x1009): ("CS", "HELICAL" if helical else "AXIAL"),
        }
        for view in range(len(geometry))
    ]


def _facing_axis(geometry: Geometry) -> tuple[Geometry, float]:
    """A flat panel that touches a curved one where the ray through the axis meets it in view 0, and how far [mm]."""
    if geometry.panel.curvature is None:
        return geometry, 0.0
    radius = geometry.panel.curvature.radius
    inward = -geometry.source[0] * [1, 1, 0]
    along, away = geometry.column_step[0] / geometry.panel.column_pitch, geometry.normals()[0]
    distance = radius * float(np.arctan2(inward @ along, abs(inward @ away)))
    touching = shifted_along(geometry, distance)
    return replace(touching, panel=replace(geometry.panel, curvature=None)), distance


def _shape(panel: Panel, sdd: Float[np.ndarray, " view"]) -> str:
    """Name of the detector's form; a curved one must be centred on the focal spot."""
    if panel.curvature is None:
        return "FLAT"
    radius = panel.curvature.radius
    if np.abs(sdd - radius).max() > _SAME * radius:
        raise GeometryError(
            f"DICOM-CT-PD has panels around the focal spot, and this one has a radius of {radius:g} mm at "
            f"{sdd[np.abs(sdd - radius).argmax()]:g} mm: resample line integrals to a flat panel (--flat-panel)"
        )
    return "CYLINDRICAL"


def _dataset(image: np.ndarray, private: dict[tuple[int, int], tuple[str, Any]], view: int, about: str) -> Any:
    """One view as a data set of pydicom."""
    pydicom, uids = import_module("pydicom"), import_module("pydicom.uid")
    instance = pydicom.Dataset()
    instance.file_meta = pydicom.dataset.FileMetaDataset()
    instance.file_meta.TransferSyntaxUID = uids.ExplicitVRLittleEndian
    instance.file_meta.MediaStorageSOPClassUID = instance.SOPClassUID = _STORAGE
    instance.file_meta.MediaStorageSOPInstanceUID = instance.SOPInstanceUID = uids.generate_uid()
    instance.Modality, instance.InstanceNumber, instance.SeriesDescription = "CT", view + 1, about
    instance.PatientName, instance.PatientID = "Simulated^Phantom", "SIMULATION"
    least, most = float(image.min()), float(image.max())
    slope = float(f"{max(most - least, 1e-6) / _STEPS * (1 + 1e-6):.10g}")
    least = float(f"{least:.8g}")
    instance.RescaleSlope, instance.RescaleIntercept = f"{slope:.10g}"[:16], f"{least:.8g}"[:16]
    instance.Rows, instance.Columns, instance.SamplesPerPixel = *image.shape, 1
    instance.BitsAllocated = instance.BitsStored = 16
    instance.HighBit, instance.PixelRepresentation, instance.PhotometricInterpretation = 15, 0, "MONOCHROME2"
    instance.PixelData = np.clip(np.rint((image - least) / slope), 0, _STEPS).astype("<u2").tobytes()
    for group in sorted({tag[0] for tag in private}):
        instance.add_new((group, 0x0010), "LO", "CT-PD")
    for (group, element), (kind, value) in private.items():
        instance.add_new((group, element), kind, value)
    return instance
