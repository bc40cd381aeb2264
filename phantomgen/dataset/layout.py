"""Layout of the HDF5 files of this project: version, names, and packing of images.

A dataset is a NeXus file. Measured data lie in ``/entry``, everything that knows the object in ``/truth``, and each
channel is shown once more, without copying, as an NXtomo entry ``/nxtomo_<channel>``.
"""

from hashlib import sha256
from typing import Any

import h5py
import numpy as np
from jaxtyping import Shaped

from phantomgen.dataset.checks.fletcher import fletcher32
from phantomgen.dataset.compression import Compression, filters, pack

SCHEMA = "spectral-ct"
SCHEMA_VERSION = (1, 1)
FRAME = "right-handed, z = rotation axis, origin = isocentre"
FRACTION_SCALE = 65535
# Most bytes of a chunk, uncompressed; rows of larger images are split.
_CHUNK_BYTES = 4 << 20


def text_of(value: Any) -> str:
    """Convert text from HDF5 to ``str``.

    Parameters
    ----------
    value : bytes or text

    Returns
    -------
    text
    """
    return value.decode() if isinstance(value, bytes) else str(value)


def put(group: h5py.Group, name: str, value: Any, units: str | None = None) -> h5py.Dataset:
    """Write a number, a text, or an array of either.

    Parameters
    ----------
    group : group that gets it
    name : name of the field
    value : the value
    units : unit; None for no attribute

    Returns
    -------
    the written field
    """
    array = np.asarray(value)
    if array.dtype.kind in "UO":
        dataset = group.create_dataset(name, data=array.astype(object), dtype=h5py.string_dtype())
    else:
        dataset = group.create_dataset(name, data=array)
    if units is not None:
        dataset.attrs["units"] = units
    return dataset


def new_group(parent: h5py.Group, name: str, nx_class: str, **attributes: Any) -> h5py.Group:
    """Create a NeXus group.

    Parameters
    ----------
    parent : group that gets it
    name : name of the group
    nx_class : its NeXus class
    **attributes : further attributes

    Returns
    -------
    the group
    """
    group = parent.create_group(name)
    group.attrs["NX_class"] = nx_class
    for key, value in attributes.items():
        group.attrs[key] = [*value] if isinstance(value, tuple) else value
    return group


def put_note(parent: h5py.Group, name: str, data: str, mime_type: str) -> None:
    """Write text as an NXnote with its checksum.

    Parameters
    ----------
    parent : group that gets it
    name : name of the note
    data : the text
    mime_type : type of the text
    """
    note = new_group(parent, name, "NXnote")
    put(note, "type", mime_type)
    put(note, "data", data)
    put(note, "checksum", sha256(data.encode()).hexdigest())
    put(note, "algorithm", "sha256")


def new_frames(
    group: h5py.Group,
    name: str,
    shape: tuple[int, ...],
    dtype: Any,
    units: str | None = None,
    compression: Compression = "gzip",
) -> h5py.Dataset:
    """Create an array of images (..., row, column), one image per chunk, compressed.

    Parameters
    ----------
    group : group that gets it
    name : name of the array
    shape : of the whole array
    dtype : of the values
    units : unit; None for no attribute
    compression : name of the compression

    Returns
    -------
    the empty array
    """
    rows = _rows_per_chunk(shape[-2], shape[-1] * np.dtype(dtype).itemsize)
    chunks = (*(1,) * (len(shape) - 2), rows, shape[-1]) if shape[0] else None
    dataset = group.create_dataset(name, shape, dtype, chunks=chunks, **(filters(compression) if chunks else {}))
    if units is not None:
        dataset.attrs["units"] = units
    return dataset


def pack_image(image: Shaped[np.ndarray, "row column"], compression: Compression = "gzip") -> list[bytes]:
    """Compress the chunks of one image as HDF5 stores them; unlike HDF5's own filters this runs in any thread.

    Parameters
    ----------
    image : values, (row, column)
    compression : name of the compression

    Returns
    -------
    bytes of each chunk
    """
    rows, columns = image.shape
    step = _rows_per_chunk(rows, columns * image.itemsize)
    padded = np.pad(image, ((0, -rows % step), (0, 0)))
    return [pack(padded[first : first + step], compression) for first in range(0, rows, step)]


def write_image(dataset: h5py.Dataset, frame: int, channel: int, packed: list[bytes]) -> None:
    """Write an image from `pack_image` at its place in an array of two leading axes, each chunk with its checksum.

    Parameters
    ----------
    dataset : array of images
    frame, channel : indices of the image
    packed : bytes of each chunk
    """
    write_image_at(dataset, (frame, channel), packed)


def write_image_at(dataset: h5py.Dataset, place: tuple[int, ...], packed: list[bytes]) -> None:
    """Write an image from `pack_image` at its place, each chunk with its checksum.

    Parameters
    ----------
    dataset : array of images
    place : indices along the leading axes
    packed : bytes of each chunk
    """
    step = _rows_per_chunk(dataset.shape[-2], dataset.shape[-1] * dataset.dtype.itemsize)
    for i, chunk in enumerate(packed):
        dataset.id.write_direct_chunk((*place, i * step, 0), chunk + fletcher32(chunk))


def _rows_per_chunk(rows: int, row_bytes: int) -> int:
    """Rows that fit a chunk."""
    return min(rows, max(1, _CHUNK_BYTES // row_bytes))
