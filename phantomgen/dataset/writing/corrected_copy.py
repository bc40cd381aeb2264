"""A copy of a dataset with other statements about the scan: poses, tube output, pixels that do not measure, flats."""

import json
import shutil
from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from jaxtyping import Float, Shaped, UInt32

from phantomgen.dataset.checks.digest import seal
from phantomgen.dataset.checks.door import find_array, group_at, has, names_in
from phantomgen.dataset.file import DATASET, FLAT, open_file
from phantomgen.dataset.geometry import write_geometry
from phantomgen.dataset.layout import new_frames, new_group, pack_image, put, write_image
from phantomgen.dataset.pixel_mask import mask_of, write_mask
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.true_poses import write_true_geometry
from phantomgen.dataset.truth import truth_group
from phantomgen.dataset.writing.nxtomo import write_aliases
from phantomgen.dataset.writing.writer import DatasetWriter, check_dataset_name
from phantomgen.geometry.poses import Geometry
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError


class CorrectedCopy(DatasetWriter):
    """Copy of a dataset whose statements are replaced; counts stay as they are. Use it in a ``with`` statement.

    Parameters
    ----------
    source : dataset that is copied
    path : name of the copy; ``<path>.part`` until complete
    overwrite : replace a file that exists

    Raises
    ------
    InputError
        When the copy is the dataset itself, exists, or has a name that is none of a dataset.
    """

    def __init__(self, source: Path, path: Path | str, overwrite: bool = False) -> None:
        check_copy(source, Path(path), overwrite)
        super().__init__(path, overwrite)
        self.source = source

    def __enter__(self) -> "CorrectedCopy":
        super().__enter__()
        return self

    def _opened(self) -> h5py.File:
        """Open the copy."""
        open_file(self.source).close()  # a damaged file is refused before it is copied
        shutil.copyfile(self.source, self.part)
        return h5py.File(self.part, "r+")

    def replace_geometry(self, stated: Geometry, corrected: Geometry) -> None:
        """Replace the stated poses; where the file has a truth, those that it stated before stay the true ones.

        Parameters
        ----------
        stated : poses that the file states
        corrected : poses that it is to state
        """
        if has(self.file, "truth") and not has(self.file, "truth/geometry"):
            write_true_geometry(truth_group(self.file), stated, None)
        entry = group_at(self.file, "entry")
        del entry["geometry"]
        write_geometry(entry, corrected)

    def replace_exposure(self, scale: Float[np.ndarray, "view channel"]) -> None:
        """Replace the tube output of the views.

        Parameters
        ----------
        scale : relative to the flats
        """
        group = group_at(self.file, "/entry/exposure")
        del group["scale"]
        put(group, "scale", scale)

    def replace_mask(self, channel: str, mask: UInt32[np.ndarray, "row column"]) -> None:
        """Replace the mask of a channel, or give it one.

        Parameters
        ----------
        channel : name of the channel
        mask : bits of each pixel
        """
        stored = mask_of(self.file, channel)
        if stored is not None:
            del self.file[str(stored.name)]
        write_mask(self.file, (channel,), mask)

    def replace_frames(self, path: str, frames: Shaped[np.ndarray, "frame channel row column"], units: str) -> None:
        """Replace flats or darks.

        Parameters
        ----------
        path : of the array, ``FLAT`` or ``DARK`` of `phantomgen.dataset.file`
        frames : int32 counts, or float32 values
        units : of the values
        """
        parent, _, name = path.rpartition("/")
        if find_array(self.file, path) is not None:
            del self.file[path]
        elif not has(self.file, parent):
            before, _, last = parent.rpartition("/")
            new_group(group_at(self.file, before), last, "NXdetector")
        array = new_frames(group_at(self.file, parent), name, frames.shape, frames.dtype, units, self.compression)
        for number, image in enumerate(frames):
            for channel, one in enumerate(image):
                write_image(array, number, channel, pack_image(np.ascontiguousarray(one), self.compression))

    def write_history(self, command: str, done: Sequence[str], settings: dict[str, Any]) -> None:
        """Add a step to the history of the file.

        Parameters
        ----------
        command : such as ``recon align``
        done : what was done, one phrase each
        settings : what steered it; name and SHA-256 of the scan are added
        """
        program, what = command.split()
        steps = sum(name.startswith("process_") for name in names_in(group_at(self.file, "entry")))
        known = {**settings, "scan": self.source.name, "sha256": file_digest(self.source)}
        self.write_step(what, steps + 1, 0, done, json.dumps(known), program)

    def finish(self, spectra: Spectra) -> None:
        """Write the aliases and the digests anew.

        Parameters
        ----------
        spectra : the spectral model
        """
        for name in names_in(self.file):
            if name.startswith("nxtomo_"):
                del self.file[name]
        if find_array(self.file, FLAT) is not None:
            write_aliases(self.file, spectra)
        seal(self.file)


def check_copy(source: Path, path: Path, overwrite: bool) -> None:
    """Refuse a name of a copy, before any work is done.

    Parameters
    ----------
    source : dataset that is copied
    path : name of the copy
    overwrite : whether a file may be replaced

    Raises
    ------
    InputError
        When the copy would be the dataset itself, exists, or has a name that is none of a dataset.
    """
    check_dataset_name(path)
    if path.exists() and source.exists() and path.samefile(source):
        raise InputError(f"the output {path} is the scan itself: choose another name by --out")
    check_output(path, overwrite, kind=DATASET)


def file_digest(path: Path) -> str:
    """Compute the SHA-256 of a file.

    Parameters
    ----------
    path : the file

    Returns
    -------
    hexadecimal digits
    """
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
