"""Sets of the Finnish Inverse Problems Society and of Helsinki: a text file of settings, and one TIFF per view.

The settings do not say which way the sample turns. Images hold readings, or line integrals where the file says so.

References
----------
.. [1] https://github.com/Diagonalizable/HelTomo, the reader of these settings.
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
    paths : one .txt file
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
    keys = read_keys(path, "DistanceSourceDetector")
    name, views = keys.text("ProjectName") or path.stem, keys.count("NumberImages")
    files = numbered_tiffs(path.parent, f"{name}_") or numbered_tiffs(path.parent, f"{path.stem}_")
    if not files:
        raise InputError(f"{path}: there are no images {name}_0001.tif beside it")
    stack = tiff_stack(files)
    if len(stack) != views:
        raise InputError(f"{path}: NumberImages is {views}, and there are {len(stack)} images")
    stated = stated.completed(_found(keys))
    first, step = keys.number("AngleFirst"), keys.number("AngleInterval")
    last = keys.number("AngleLast", first + step * (views - 1))
    if abs(first + step * (views - 1) - last) > 0.5 * abs(step):
        raise InputError(
            f"{path}: {views} images from AngleFirst {first:g} in steps of {step:g} do not end at AngleLast {last:g}"
        )
    panel = Panel(*stack.shape, stated.pitch or 0.0)
    table = Turntable(float(stated.sod or 0.0), float(stated.sdd or 0.0), panel).with_axis_at(
        stated_axis(stated, panel.columns)
    )

    def image(view: int) -> Image:
        return stack[view][None]

    return RawScan(
        path=path,
        title=name,
        values="readings",
        channels=("signal",),
        geometry=table.views(turning(first + step * np.arange(views), stated)),
        image=as_stored(image, stated),
        stated=stated,
        notes=(
            "the panel was taken as a CsI scintillator",
            "this format does not say which way the sample turns: if the volume is blurred, add --reverse",
        ),
    )


def _found(keys: Keys) -> dict[str, object]:
    """Facts that the file states."""
    thickness, metal = keys.number("XRayFilterThickness", 0.0), keys.text("XRayFilter")
    pitch = keys.number("PixelSize")
    found: dict[str, object] = {
        "kvp": keys.optional("Voltage"),
        "sod": keys.number("DistanceSourceOrigin"),
        "sdd": keys.number("DistanceSourceDetector"),
        "pitch": (pitch, pitch),
        "scintillator": "CsI",
    }
    if thickness > 0 and metal:
        found["filters"] = f"{thickness:g} mm {metal}"
    return found
