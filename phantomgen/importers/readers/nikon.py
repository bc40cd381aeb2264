"""Nikon XTEK: an ``.xtekct`` file with one TIFF of 16 bits per view, or one raw file of all views.

The column order, the angle at which the first view is taken, and the axis are as CIL's reader has them; files ``.ang``
and ``_ctdata.txt`` are not read. Pixels read a part of the white level in the open beam.

References
----------
.. [1] https://github.com/TomographicImaging/CIL, Wrappers/Python/cil/io/NikonDataReader.py.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.importers.files.images import Stack, numbered_tiffs, raw_stack, tiff_stack
from phantomgen.importers.files.key_values import Keys, read_keys
from phantomgen.importers.readers.turntable import Turntable, as_stored, stated_axis, turning
from phantomgen.importers.scans.raw_scan import Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError

_FIRST = 90.0  # angle of the source when the table stands at 0 [degree]
_METALS = {"Copper": "Cu", "Tin": "Sn", "Aluminium": "Al", "Aluminum": "Al", "Silver": "Ag", "Iron": "Fe", "Lead": "Pb"}


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : one .xtekct file
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When the file lacks a key, or images are missing or damaged.
    """
    path = paths[0]
    keys = read_keys(path, "[XTekCT]")
    views = keys.count("Projections")
    panel = Panel(
        keys.count("DetectorPixelsY"),
        keys.count("DetectorPixelsX"),
        (keys.number("DetectorPixelSizeY"), keys.number("DetectorPixelSizeX")),
    )
    stack = _images(path, keys, views, (panel.rows, panel.columns))
    found, notes = _found(keys)
    alone = len(stack) == 1 < views
    if alone:
        notes.append(f"the one radiogram stands for all {views} views of a body of revolution")
    elif len(stack) != views:
        raise InputError(f"{path}: Projections is {views}, and there are {len(stack)} images")
    stated = stated.completed(found)
    angles = keys.number("InitialAngle", 0.0) + keys.number("AngularStep") * np.arange(views) + _FIRST
    table = _table(keys, stated, panel).with_axis_at(stated_axis(stated, panel.columns, reverse=True))

    def image(view: int) -> Image:
        return stack[0 if alone else view][None, :, ::-1]

    return RawScan(
        path=path,
        title=keys.text("Name") or path.stem,
        values="readings",
        channels=("signal",),
        geometry=table.views(turning(angles, stated)),
        image=as_stored(image, stated),
        stated=stated,
        notes=tuple(notes),
    )


def _images(path: Path, keys: Keys, views: int, shape: tuple[int, int]) -> Stack:
    """TIFF files of all views, one raw file, or a single radiogram."""
    name, folder = keys.text("Name") or path.stem, path.parent / keys.text("InputFolderName").replace("\\", "/")
    starts = dict.fromkeys((f"{name}{keys.text('InputSeparator') or '_'}", f"{path.stem}_", name, path.stem))
    for place in dict.fromkeys((folder, path.parent)):
        for start in starts:
            files = numbered_tiffs(place, start)
            if files:
                return tiff_stack(files, shape)
    for suffix in (".raw", ".tif", ".tiff"):
        file = path.with_suffix(suffix)
        if file.is_file():
            return raw_stack(file, views, shape) if suffix == ".raw" else tiff_stack([file], shape)
    raise InputError(f"{path}: there are no images {next(iter(starts))}0001.tif in {folder}, and no {path.stem}.raw")


def _found(keys: Keys) -> tuple[dict[str, object], list[str]]:
    """Facts that the file states, and what is taken to be so."""
    thickness, metal = keys.number("Filter_ThicknessMM", 0.0), keys.text("Filter_Material")
    found: dict[str, object] = {
        "kvp": keys.optional("XraykV"),
        "sod": keys.number("SrcToObject"),
        "sdd": keys.number("SrcToDetector"),
        "white": keys.optional("WhiteLevel"),
        "scintillator": "CsI",
    }
    if thickness > 0 and metal:
        found["filters"] = f"{thickness:g} mm {_METALS.get(metal, metal)}"
    said = ["the panel was taken as a CsI scintillator"]
    return found, [*said, f"the filter is {found['filters']}"] if "filters" in found else said


def _table(keys: Keys, stated: Stated, panel: Panel) -> Turntable:
    """Source and panel around the axis, which may lie beside the central ray and lean."""
    sod, sdd = float(stated.sod or 0.0), float(stated.sdd or 0.0)
    top, bottom = (keys.number(f"CentreOfRotation{end}", 0.0) for end in ("Top", "Bottom"))
    magnified = sod / sdd if sdd else 0.0
    shift = keys.number("ObjectOffsetX", (top + bottom) / 2 * magnified)
    height = panel.rows * panel.row_pitch
    roll = np.deg2rad(keys.number("ObjectRoll", float(np.rad2deg(-np.arctan2(top - bottom, height)))))
    tilt = -np.deg2rad(keys.number("ObjectTilt", 0.0))
    # In CIL's frame (x along columns, y along the beam): the z axis rolled about y, then tilted about x.
    x, z = np.sin(roll), np.cos(roll)
    y, z = -np.sin(tilt) * z, np.cos(tilt) * z
    offset = keys.number("DetectorOffsetX", 0.0)
    return Turntable(
        sod,
        sdd,
        panel,
        source_y=shift,
        panel_y=shift - offset,
        panel_z=keys.number("DetectorOffsetY", 0.0),
        axis=(-float(y), float(x), float(z)),
    )
