"""Content of a page of slices from a run folder and the dataset that it was made from."""

import os
from pathlib import Path

from recon.output.slice_page.page import SliceContent, slice_page
from recon.output.viewer.load import load_run
from recon.readouts.readouts import Readouts
from recon.readouts.spectrum import detected_spectrum
from recon.runs.read_run import open_model
from spectra.errors import InputError


def load_slices(folder: Path, dataset: Path | None = None) -> SliceContent:
    """Read the content of a page.

    Parameters
    ----------
    folder : run folder
    dataset : dataset with the truth, see `recon.output.viewer.load.load_run`

    Returns
    -------
    the content; without the truth where that has basis functions that the run lacks

    Raises
    ------
    DatasetError
        When the folder is not a run, or `dataset` holds no truth.
    InputError
        When truth and run have no basis in common.
    """
    stored, content = open_model(folder), load_run(folder, dataset)
    names = content.basis_names
    volumes = {"result": content.result}
    if content.true is not None and set(names) <= set(stored.basis.names):
        volumes["truth"] = content.true
    known = [name for name in stored.basis.names if name in names]
    order = [names.index(name) for name in known]
    readouts = Readouts.of(stored.basis, *detected_spectrum(stored.basis, stored.transmission))
    volumes = {kind: values[order] for kind, values in volumes.items()}
    return SliceContent(content.name, content.grid, tuple(known), volumes, readouts)


def write_slices(content: SliceContent, path: Path) -> int:
    """Write a page of slices beside its name, then rename it.

    Parameters
    ----------
    content : what is shown
    path : HTML file

    Returns
    -------
    size [byte]

    Raises
    ------
    InputError
        When the page cannot be written.
    """
    part = path.with_name(path.name + ".part")
    try:
        part.write_text(slice_page(content), encoding="utf-8")
        os.replace(part, path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise InputError(f"{path} cannot be written: {error.strerror}") from None
    return path.stat().st_size
