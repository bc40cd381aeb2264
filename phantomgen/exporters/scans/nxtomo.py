"""One NXtomo file per channel: flats, projections and darks as counts, angles and distances.

NXtomo knows rotation angles, source and detector distance, and no pose of the panel: scans with more are refused.
"""

from contextlib import ExitStack
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import Frames, file_name, fill
from phantomgen.geometry.conversions.central_circle import CentralCircle, central_circle_of

KINDS: tuple[Kind, ...] = ("counts",)
SCRIPT = """
scan, name = load()
entry = NXtomo().load(f"{scan['files'][name]}.nx", "entry0000")
key = np.array([k.value for k in entry.instrument.detector.image_key])
with h5py.File(f"{scan['files'][name]}.nx") as file:
    frames = file["entry0000/instrument/detector/data"][()].astype(float)
    exposure = file["entry0000/control/data"][()]
flat, dark = (frames[key == k].mean(axis=0) if (key == k).any() else 0.0 for k in (1, 2))
air = (flat - dark) * exposure[key == 0, None, None]
data = np.log(air / np.maximum(frames[key == 0] - dark, 0.5))  # (view, row, column)
print("line integrals", data.shape, "from", data.min(), "to", data.max(), "as nabu and nabu-fdk read them")
"""
IMPORTS = "import h5py\nfrom nxtomo.application.nxtomo import NXtomo"
_PROJECTION, _FLAT, _DARK = 0, 1, 2
_VERSION = 1.4


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write one file per channel.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know: nothing
    """
    circle = central_circle_of(projections.geometry, "NXtomo")
    with ExitStack() as files:
        frames = []
        for number, name in enumerate(projections.names):
            file = files.enter_context(h5py.File(folder / f"{file_name(name)}.nx", "w"))
            frames.append(_write_entry(file, projections, number, circle))
        fill(projections, frames)
    return {}


def _write_entry(file: h5py.File, projections: Projections, number: int, circle: CentralCircle) -> Frames:
    """Write one channel but its projections, whose place is returned."""
    panel, views = projections.geometry.panel, len(projections)
    file.attrs.update({"NX_class": "NXroot", "default": "entry0000"})
    entry = _group(file, "entry0000", "NXentry", default="data", version=_VERSION)
    entry["definition"], entry["title"] = "NXtomo", f"{projections.title}, {projections.names[number]}"
    instrument = _group(entry, "instrument", "NXinstrument")
    source = _group(instrument, "source", "NXsource")
    source["type"], source["probe"] = "Fixed Tube X-ray", "x-ray"
    if not projections.geometry.is_parallel:
        _put(source, "distance", -circle.sod * 1e-3, "m")
    if np.isfinite(projections.energies[number]):
        _put(_group(instrument, "beam", "NXbeam"), "incident_energy", projections.energies[number], "keV")
    detector = _group(instrument, "detector", "NXdetector")
    flats, darks = (np.empty((0, 1)) if f is None else f[:, number] for f in (projections.flats, projections.darks))
    keys = np.repeat([_FLAT, _PROJECTION, _DARK], [len(flats), views, len(darks)]).astype(np.int32)
    shape, kind = (len(keys), panel.rows, panel.columns), projections.image(0).dtype
    data = detector.create_dataset("data", shape, kind, chunks=(1, *shape[1:]), compression="gzip", shuffle=True)
    data.attrs["units"] = "counts"
    for first, frames in ((0, flats), (len(flats) + views, darks)):
        if len(frames):
            data[first : first + len(frames)] = frames
    detector["image_key"] = detector["image_key_control"] = keys
    for axis, size in (("x", panel.column_pitch), ("y", panel.row_pitch)):
        _put(detector, f"{axis}_pixel_size", size * 1e-3, "m")
    _put(detector, "distance", (circle.sdd - circle.sod) * 1e-3, "m")
    sample = _group(entry, "sample", "NXsample")
    sample["name"] = projections.title
    angles, exposure = np.zeros(len(keys)), np.ones(len(keys))
    angles[keys == _PROJECTION] = -np.rad2deg(circle.angles)  # the sample turns, not the source
    if projections.exposure is not None:
        exposure[keys == _PROJECTION] = projections.exposure[:, number]
    _put(sample, "rotation_angle", angles, "degree")
    # Readers take the monitor for a current, and scale by it: relative to the flats is what matters.
    _put(_group(entry, "control", "NXmonitor"), "data", exposure, "A")
    plot = _group(entry, "data", "NXdata", signal="data")
    for name, target in (
        ("data", "instrument/detector/data"),
        ("image_key", "instrument/detector/image_key"),
        ("rotation_angle", "sample/rotation_angle"),
    ):
        plot[name] = h5py.SoftLink(f"/entry0000/{target}")
    return Frames(data, first=len(flats))


def _group(parent: h5py.Group, name: str, kind: str, **attributes: Any) -> h5py.Group:
    group = parent.create_group(name)
    group.attrs.update({"NX_class": kind, **attributes})
    return group


def _put(group: h5py.Group, name: str, value: Any, units: str) -> None:
    group[name] = value
    group[name].attrs["units"] = units
