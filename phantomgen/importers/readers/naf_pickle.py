"""Pickles of NAF and SAX-NeRF: line integrals and poses; one file per channel. Nothing in a pickle is run."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phantomgen.importers.naf import read_naf, read_naf_geometry
from phantomgen.importers.readers.channel_names import channel_names
from phantomgen.importers.readers.r2_folder import check_same
from phantomgen.importers.readers.turntable import as_stored
from phantomgen.importers.scans.raw_scan import Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : pickles
    stated : facts that the user states

    Returns
    -------
    the scan, its validation views last

    Raises
    ------
    InputError
        When a file is damaged, holds more than arrays and numbers, or lacks a key.
    """
    found = [read_naf_geometry(path) for path in paths]
    check_same(paths, found)
    panel = found[0].geometry.panel
    stacks = [_projections(path, (len(found[0].geometry), panel.rows, panel.columns)) for path in paths]

    def image(view: int) -> Image:
        return np.stack([stack[view] for stack in stacks])

    return RawScan(
        path=paths[0],
        title=paths[0].stem,
        values="line-integrals",
        channels=channel_names(paths),
        geometry=found[0].geometry,
        image=as_stored(image, stated),
        stated=stated,
        train=found[0].train,
        grid=found[0].grid,
        notes=("lengths were taken as mm, as the method's reader does",),
    )


def _projections(path: Path, shape: tuple[int, int, int]) -> Image:
    """Line integrals of all views."""
    values = read_naf(path)
    try:
        parts = [np.asarray(values[part]["projections"], np.float32) for part in ("train", "val") if part in values]
        stack = np.concatenate(parts)
    except (TypeError, KeyError, ValueError):
        raise InputError(f"{path}: train and val must each have projections (view, row, column)") from None
    if stack.shape != shape:
        raise InputError(f"{path}: projections have shape {stack.shape}, its geometry says {shape}")
    return stack
