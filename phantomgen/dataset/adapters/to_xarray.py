"""Counts with named axes, for xarray."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from spectra.errors import NotInstalledError

if TYPE_CHECKING:
    from xarray import DataArray

    from phantomgen.dataset.reader import Dataset


def to_xarray(dataset: "Dataset", views: Sequence[int] | None = None) -> "DataArray":
    """Read counts of some views with axes (view, channel, row, column) and coordinates along them.

    Parameters
    ----------
    dataset : open dataset
    views : numbers of the views; all where left out

    Returns
    -------
    the counts

    Raises
    ------
    NotInstalledError
        Without xarray.
    """
    try:
        import xarray  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError("named arrays need xarray: pip install 'spectral-ct[xarray]'") from None
    chosen = np.arange(dataset.counts.shape[0]) if views is None else np.asarray(views, dtype=np.int64)
    spectra, panel = dataset.spectra, dataset.geometry.panel
    offsets = [
        (np.arange(count) - (count - 1) / 2) * pitch
        for count, pitch in ((panel.rows, panel.row_pitch), (panel.columns, panel.column_pitch))
    ]
    split = np.full(dataset.counts.shape[0], "", dtype=object)
    for name, members in dataset.splits.items():
        split[members] = name
    return xarray.DataArray(
        dataset.load(chosen),
        dims=("view", "channel", "row", "column"),
        coords={
            "view": chosen,
            "angle": ("view", np.rad2deg(dataset.geometry.angles[chosen]), {"units": "degree"}),
            "split": ("view", split[chosen].astype(str)),
            "channel": list(spectra.channels),
            "lower": ("channel", spectra.lower, {"units": "keV"}),
            "upper": ("channel", spectra.upper, {"units": "keV"}),
            "row": ("row", offsets[0], {"units": "mm", "long_name": "from the panel's centre, downwards"}),
            "column": ("column", offsets[1], {"units": "mm", "long_name": "from the panel's centre"}),
        },
        name="counts" if spectra.units == "counts" else "signal",
        attrs={"units": spectra.units, "title": dataset.name},
    )
