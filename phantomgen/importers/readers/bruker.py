"""Bruker and SkyScan: a ``.log`` file with one TIFF per view, corrected by flats, of 2^depth in the open beam.

Sizes of pixels are taken from that in the image and the magnification, so that binning is in them.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phantomgen.geometry.panel import Panel
from phantomgen.importers.files.images import numbered_tiffs, tiff_stack
from phantomgen.importers.files.key_values import Keys, read_keys
from phantomgen.importers.readers.turntable import Turntable, as_stored, stated_axis, turning
from phantomgen.importers.scans.raw_scan import Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : one .log file
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
    keys = read_keys(path, "[Acquisition]")
    shape = keys.count("Number of Rows"), keys.count("Number of Columns")
    prefix = keys.text("Filename Prefix") or path.stem
    files = numbered_tiffs(path.parent, prefix) or numbered_tiffs(path.parent, path.stem)
    if not files:
        raise InputError(f"{path}: there are no images {prefix}0000.tif beside it")
    stack = tiff_stack(files, shape)
    views = keys.count("Number of Files")
    if len(stack) not in (views, views + 1):  # one more may be taken at the end, to see whether the sample moved
        raise InputError(f"{path}: Number of Files is {views}, and there are {len(stack)} images")
    stated = stated.completed(_found(keys))
    step = keys.number("Rotation Step (deg)")
    # The sample turns by an angle as the source turns by its opposite.
    sense = -1.0 if keys.text("Rotation Direction").upper().startswith("CC") else 1.0
    table = _table(keys, stated, shape)

    def image(view: int) -> Image:
        return stack[view][None]

    return RawScan(
        path=path,
        title=prefix,
        values="readings",
        channels=("signal",),
        geometry=table.views(turning(sense * step * np.arange(views), stated)),
        image=as_stored(image, stated),
        stated=stated,
        notes=(
            *(("Image Rotation is not applied",) if keys.number("Image Rotation", 0.0) else ()),
            "the panel was taken as a CsI scintillator",
            "the sample was taken to turn as Rotation Direction says, seen from above: if the volume is blurred, add "
            "--reverse",
            *(("Optical Axis (line) was counted from the lowest row",) if keys.text("Optical Axis (line)") else ()),
        ),
    )


def _found(keys: Keys) -> dict[str, object]:
    """Facts that the file states; its filter is a word such as ``Al 0.5mm`` or ``no filter``."""
    sod, sdd = keys.number("Object to Source (mm)"), keys.number("Camera to Source (mm)")
    if not 0 < sod < sdd:
        raise InputError(f"{keys.path}: Object to Source must lie between 0 and Camera to Source, got {sod:g}, {sdd:g}")
    pixel = keys.number("Image Pixel Size (um)") * 1e-3 * sdd / sod
    depth = keys.number("Depth (bits)", 16.0)
    if not 1 <= depth <= 32:
        raise InputError(f"{keys.path}: Depth (bits) must be 1 to 32, got {depth:g}")
    return {
        "kvp": keys.optional("Source Voltage (kV)"),
        "sod": sod,
        "sdd": sdd,
        "pitch": (pixel, pixel),
        "white": 2.0**depth - 1,
        "scintillator": "CsI",
        "filters": _layers(keys.text("Filter")),
    }


def _layers(text: str) -> str | None:
    """Layers from words such as ``Al 0.5mm`` or ``Al 1 mm + Cu 0.05mm``; None where they are something else."""
    layers = []
    for part in text.replace("mm", " ").split("+"):
        words = part.split()
        try:
            layers.append(f"{float(words[1]):g} mm {words[0]}")
        except (IndexError, ValueError):
            return None
    return " + ".join(layers)


def _table(keys: Keys, stated: Stated, shape: tuple[int, int]) -> Turntable:
    """Source and panel; the central ray meets the panel in the row that the file names, counted from below."""
    rows, columns = shape
    panel = Panel(rows, columns, stated.pitch or 0.0)
    line = keys.number("Optical Axis (line)", (rows - 1) / 2)
    table = Turntable(float(stated.sod or 0.0), float(stated.sdd or 0.0), panel)
    shifted = Turntable(table.sod, table.sdd, panel, panel_z=((rows - 1) / 2 - line) * panel.row_pitch)
    return shifted.with_axis_at(stated_axis(stated, columns))
