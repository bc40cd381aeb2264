"""Projections of a fitted model in HDF5: line integrals of every basis and expected counts, a view at a time."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float

from phantomgen.dataset.geometry import write_geometry
from phantomgen.dataset.layout import new_frames, new_group, put
from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.config import read_geometry_file
from phantomgen.geometry.poses import Geometry
from recon.data.measurements import read_measurements
from recon.output.volume_file import whole_file
from recon.runs.run_folder import Run
from spectra.errors import InputError
from spectra.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Views:
    """Views to render.

    Parameters
    ----------
    geometry : poses of the views
    channels : names of the channels
    transmission : spectral model of the pixels; its columns are the bases of the model, then the parts of `profile`
    gains : counts of each pixel in the open beam over those of `transmission`; 0 for pixels that do not measure
    exposure : relative exposure of each view and channel
    profile : path lengths in the materials of a bowtie filter and of the heel effect [mm]; None where there are none
    """

    geometry: Geometry
    channels: tuple[str, ...]
    transmission: Transmission
    gains: Float[np.ndarray, "channel row column"]
    exposure: Float[np.ndarray, "view channel"]
    profile: Float[np.ndarray, "part row column"] | None = None


def views_of_dataset(run: Run, path: Path) -> Views:
    """Return all views of a dataset, with its open beam.

    Parameters
    ----------
    run : a finished fit
    path : dataset

    Returns
    -------
    views; their counts are those of the frames above the dark frames

    Raises
    ------
    InputError
        When the dataset has other basis functions than the model.
    """
    names = run.gaussians.basis_names
    with open_dataset(path) as dataset:
        if dataset.spectra.basis.names[: len(names)] != names:
            others = ", ".join(dataset.spectra.basis.names)
            raise InputError(f"the model has the bases {', '.join(names)}, but {path} has {others}")
        one = read_measurements(dataset, np.array([0]), len(names), separable=False)
        channels, exposure = dataset.spectra.channels, np.array(dataset.exposure)
        return Views(dataset.geometry, channels, one.transmission, one.gains, exposure, one.profile)


def views_of_file(run: Run, path: Path) -> Views:
    """Return the views of a geometry file, with ideal pixels and as many photons as in the scan that was fitted.

    Parameters
    ----------
    run : a finished fit
    path : geometry file

    Returns
    -------
    views
    """
    return views_of_geometry(run, read_geometry_file(path))


def views_of_geometry(run: Run, geometry: Geometry) -> Views:
    """Return any views, with ideal pixels and as many photons as in the scan that was fitted.

    Parameters
    ----------
    run : a finished fit
    geometry : poses of the views

    Returns
    -------
    views
    """
    transmission = run.transmission
    gains = np.ones((len(transmission), geometry.panel.rows, geometry.panel.columns), np.float32)
    exposure = np.ones((len(geometry), len(transmission)))
    return Views(geometry, transmission.channel_names, transmission, gains, exposure)


def write_render(path: Path, run: Run, views: Views, on_view: Callable[[int, int], None]) -> None:
    """Write ``/line_integrals/data`` (view, basis, row, column) and ``/counts/data`` (view, channel, row, column).

    Parameters
    ----------
    path : file to write
    run : a finished fit
    views : views to render
    on_view : called with the number of views that are done, and of all views
    """
    names, total, panel = run.gaussians.basis_names, len(views.geometry), views.geometry.panel
    with whole_file(path) as file:
        file.attrs.update({"NX_class": "NXroot", "default": "counts", "creator": "recon"})
        arrays = []
        for group_name, axis, labels, units in (
            ("line_integrals", "basis_name", names, "1"),
            ("counts", "channel", views.channels, "counts"),
        ):
            group = new_group(file, group_name, "NXdata", signal="data", axes=("view", axis, ".", "."))
            put(group, axis, np.array(labels, dtype=object))
            arrays.append(new_frames(group, "data", (total, len(labels), panel.rows, panel.columns), np.float32, units))
        write_geometry(file, views.geometry)
        for view in range(total):
            arrays[0][view], arrays[1][view] = rendered(run, views, view)
            on_view(view + 1, total)


def rendered(
    run: Run, views: Views, view: int
) -> tuple[Float[np.ndarray, "basis row column"], Float[np.ndarray, "channel row column"]]:
    """Compute the line integrals of every basis in one view, and the expected counts.

    Parameters
    ----------
    run : a finished fit
    views : views to render
    view : index of the view

    Returns
    -------
    line integrals [no unit], and expected counts
    """
    with torch.no_grad():
        lengths = run.gaussians.line_integrals(views.geometry[[view]])[0].numpy()
    return lengths, _expected(views, lengths) * views.exposure[view][:, None, None]


def _expected(views: Views, lengths: Float[np.ndarray, "basis row column"]) -> Float[np.ndarray, "channel row column"]:
    """Expected counts at exposure 1."""
    known = lengths if views.profile is None else np.concatenate([lengths, views.profile.astype(lengths.dtype)])
    return np.moveaxis(views.transmission.expected(np.moveaxis(known, 0, -1)), -1, 0) * views.gains
