"""The same counts as one NXtomo entry per channel, by virtual datasets that hold no bytes.

NXtomo wants frames of rank 3 with flats and darks among them, so a spectral scan becomes one entry per channel. Its
readers (nxtomo, nabu, tomopy and others) open these as they are.
"""

import h5py
import numpy as np

from phantomgen.dataset.checks.door import array_at, value_at
from phantomgen.dataset.file import DARK, DETECTOR, FLAT
from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.pixel_mask import mask_of
from phantomgen.dataset.spectral_model import Spectra

# Values of image_key in the NeXus definition NXtomo; version of the format, as ESRF's package nxtomo counts it.
_PROJECTION, _FLAT, _DARK = 0, 1, 2
_NXTOMO_VERSION = 1.4


def write_aliases(file: h5py.File, spectra: Spectra) -> None:
    """Add ``/nxtomo_<channel>``; files that NXtomo cannot express get none.

    NXtomo knows integer counts and rotation angles only.

    Parameters
    ----------
    file : open dataset
    spectra : channels of the dataset
    """
    angles = value_at(file, "entry/sample/rotation_angle")
    if not np.issubdtype(array_at(file, f"{DETECTOR}/data").dtype, np.integer) or not np.isfinite(angles).all():
        return
    for channel, name in enumerate(spectra.channels):
        _write_entry(file, channel, name, float(spectra.effective_energy[channel]))


def _write_entry(file: h5py.File, channel: int, name: str, energy: float) -> None:
    """One channel: flats, projections, darks."""
    entry = new_group(file, f"nxtomo_{name}", "NXentry", default="data", version=_NXTOMO_VERSION)
    put(entry, "definition", "NXtomo")
    entry["title"] = h5py.SoftLink("/entry/title")
    entry["start_time"] = h5py.SoftLink("/entry/start_time")
    instrument = new_group(entry, "instrument", "NXinstrument")
    instrument["source"] = h5py.SoftLink("/entry/instrument/source")
    put(new_group(instrument, "beam", "NXbeam"), "incident_energy", energy, "keV")
    detector = new_group(instrument, "detector", "NXdetector")
    keys = _write_frames(file, detector, channel)
    for size in ("x_pixel_size", "y_pixel_size", "distance"):
        detector[size] = h5py.SoftLink(f"{DETECTOR}/{size}")
    mask = mask_of(file, name)
    if mask is not None:
        detector["pixel_mask"] = h5py.SoftLink(mask.name)
    sample = new_group(entry, "sample", "NXsample")
    sample["name"] = h5py.SoftLink("/entry/sample/name")
    angles = np.zeros(len(keys))
    angles[keys == _PROJECTION] = value_at(file, "entry/sample/rotation_angle")
    put(sample, "rotation_angle", angles, "degree")
    data = new_group(entry, "data", "NXdata", signal="data")
    for link, target in (
        ("data", "instrument/detector/data"),
        ("image_key", "instrument/detector/image_key"),
        ("rotation_angle", "sample/rotation_angle"),
    ):
        data[link] = h5py.SoftLink(f"/nxtomo_{name}/{target}")


def _write_frames(file: h5py.File, detector: h5py.Group, channel: int) -> np.ndarray:
    """Write the virtual frames and their keys; returns the keys."""
    order = ((FLAT, _FLAT), (f"{DETECTOR}/data", _PROJECTION), (DARK, _DARK))
    parts = [(array_at(file, path), key) for path, key in order]
    keys = np.concatenate([np.full(frames.shape[0], key, dtype=np.int32) for frames, key in parts])
    _create_virtual(detector, "data", [frames for frames, _ in parts], channel)
    detector["data"].attrs["units"] = "counts"
    put(detector, "image_key", keys)
    put(detector, "image_key_control", keys)
    return keys


def _create_virtual(group: h5py.Group, name: str, sources: list[h5py.Dataset], channel: int) -> None:
    """Create a dataset of one channel of all `sources`, one after the other.

    In HDF5's own terms, because h5py's would store the time of writing and make files differ.
    """
    image = sources[0].shape[2:]
    target = h5py.h5s.create_simple((sum(source.shape[0] for source in sources), *image))
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_obj_track_times(False)
    first = 0
    for source in sources:
        count = source.shape[0]
        if count:
            target.select_hyperslab((first, 0, 0), (count, *image))
            origin = source.id.get_space()
            origin.select_hyperslab((0, channel, 0, 0), (count, 1, *image))
            # The file "." is this one, so that it may be renamed.
            settings.set_virtual(target, b".", str(source.name).encode(), origin)
        first += count
    target.select_all()
    h5py.h5d.create(group.id, name.encode(), sources[0].id.get_type(), target, settings)
