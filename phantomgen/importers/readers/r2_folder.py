"""Data folders of R2-Gaussian: ``meta_data.json`` and line integrals as ``.npy``; one folder per channel."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from phantomgen.importers.r2_gaussian import FolderGeometry, read_r2_geometry
from phantomgen.importers.readers.channel_names import channel_names
from phantomgen.importers.readers.turntable import as_stored
from phantomgen.importers.scans.raw_scan import Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : folders
    stated : facts that the user states

    Returns
    -------
    the scan, its test views last

    Raises
    ------
    InputError
        When a file is missing, damaged or of another shape, or folders have different views.
    """
    found = [read_r2_geometry(path) for path in paths]
    check_same(paths, found)
    files = [_files(path) for path in paths]
    panel = found[0].geometry.panel

    def image(view: int) -> Image:
        return np.stack([_image(own[view], (panel.rows, panel.columns)) for own in files])

    return RawScan(
        path=paths[0],
        title=paths[0].resolve().name,
        values="line-integrals",
        channels=channel_names(paths),
        geometry=found[0].geometry,
        image=as_stored(image, stated),
        stated=stated,
        train=found[0].train,
        grid=found[0].grid,
        notes=(() if _has_unit(paths[0]) else ("lengths were taken as mm: this format does not state their unit",)),
    )


def check_same(paths: Sequence[Path], found: Sequence[FolderGeometry]) -> None:
    """Refuse channels of different views.

    Parameters
    ----------
    paths : files or folders of the channels
    found : their poses

    Raises
    ------
    InputError
        When they differ.
    """
    for path, one in zip(paths, found, strict=True):
        if one.geometry != found[0].geometry or one.train != found[0].train:
            raise InputError(f"{path} has other views than {paths[0]}: channels of one scan have the same views")


def _has_unit(folder: Path) -> bool:
    return "unit_mm" in json.loads((folder / "meta_data.json").read_text(encoding="utf-8"))["scanner"]


def _files(folder: Path) -> list[Path]:
    """Files of all views, those for training first; none outside of the folder."""
    meta = json.loads((folder / "meta_data.json").read_text(encoding="utf-8"))
    found = []
    for entry in [*meta.get("proj_train", []), *meta.get("proj_test", [])]:
        path = folder / str(entry.get("file_path", ""))
        if not path.resolve().is_relative_to(folder.resolve()) or not path.is_file():
            raise InputError(f"{folder}/meta_data.json: there is no file {entry.get('file_path')!r} in the folder")
        found.append(path)
    return found


def _image(path: Path, shape: tuple[int, int]) -> Shaped[np.ndarray, "row column"]:
    """One view; only arrays of numbers are read."""
    try:
        image = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError):
        raise InputError(f"{path} cannot be read: it is no array of numpy, or cut off") from None
    if not isinstance(image, np.ndarray) or image.shape != shape or image.dtype.kind not in "uif":
        raise InputError(
            f"{path} holds {getattr(image, 'dtype', 'nothing')} of shape {np.shape(image)}, expected {shape}"
        )
    return np.array(image)
