"""How arrays are compressed in a dataset, and how a thread of ours does what HDF5 would do under a lock.

`gzip` opens everywhere. `bitshuffle` (bit planes, LZ4) is several times faster to write and to read; readers need the
plugin of the package hdf5plugin (Masui et al. 2015, doi:10.1016/j.ascom.2015.07.002).
"""

import zlib
from itertools import count
from typing import Any, Literal, get_args

import h5py
import numpy as np
from jaxtyping import Shaped

from phantomgen.dataset.checks.door import find_array
from spectra.errors import InputError, NotInstalledError

Compression = Literal["gzip", "bitshuffle", "none"]
BITSHUFFLE = 32008  # registered number of the filter
# Level of gzip: 4 takes twice as long to write for 5 % less (60 x 5 x 512 x 512 Poisson counts).
_GZIP_LEVEL = 1
_numbers = count()


def check_compression(name: str) -> None:
    """Refuse a compression that is unknown or not installed.

    Parameters
    ----------
    name : name of the compression

    Raises
    ------
    InputError
        When the name is unknown.
    """
    if name not in get_args(Compression):
        raise InputError(f"there is no compression {name!r}: choose from {', '.join(get_args(Compression))}")
    if name == "bitshuffle":
        _plugin("the compression bitshuffle")


def filters(compression: Compression) -> dict[str, Any]:
    """Return the keyword arguments of h5py for a compression; the last filter is the checksum Fletcher-32.

    Parameters
    ----------
    compression : name of the compression

    Returns
    -------
    keyword arguments of ``create_dataset``
    """
    if compression == "bitshuffle":
        return {**_plugin("the compression bitshuffle").Bitshuffle(), "fletcher32": True}
    if compression == "gzip":
        return {"compression": "gzip", "compression_opts": _GZIP_LEVEL, "shuffle": True, "fletcher32": True}
    return {"fletcher32": True}


def pack(chunk: Shaped[np.ndarray, "row column"], compression: Compression) -> bytes:
    """Compress one chunk as the HDF5 filters do, without the checksum at the end.

    Parameters
    ----------
    chunk : values, (row, column)
    compression : name of the compression

    Returns
    -------
    bytes of the chunk
    """
    if compression == "gzip":  # shuffle: byte planes one after the other
        planes = np.ascontiguousarray(chunk).view(np.uint8).reshape(-1, chunk.itemsize).T
        return zlib.compress(planes.tobytes(), _GZIP_LEVEL)
    if compression == "bitshuffle":
        return _by_hdf5(chunk, compression)
    return chunk.tobytes()


def check_readable(file: h5py.File, name: str) -> None:
    """Check that the filters of an array are available; load the plugin where it is needed.

    Parameters
    ----------
    file : open dataset
    name : path of the array
    """
    dataset = find_array(file, name)
    if dataset is None:
        return
    settings = dataset.id.get_create_plist()
    used = {settings.get_filter(i)[0] for i in range(settings.get_nfilters())}
    if BITSHUFFLE in used and not _is_there(BITSHUFFLE):
        _plugin(f"reading {file.filename}, which is compressed by bitshuffle,")


def _is_there(number: int) -> bool:
    """Return whether HDF5 knows a filter."""
    return bool(h5py.h5z.filter_avail(number))


def _by_hdf5(chunk: Shaped[np.ndarray, "row column"], compression: Compression) -> bytes:
    """One chunk through HDF5's own filters, in a file that exists in memory only."""
    with h5py.File(f"chunk-{next(_numbers)}", "w", driver="core", backing_store=False) as file:
        dataset = file.create_dataset("chunk", data=chunk, chunks=chunk.shape, **filters(compression))
        return dataset.id.read_direct_chunk((0, 0))[1][:-4]  # without the checksum


def _plugin(what: str) -> Any:
    """The module that registers the filter."""
    try:
        import hdf5plugin  # noqa: PLC0415 - an extra
    except ImportError:
        raise NotInstalledError(f"{what} needs the extra compress: pip install 'spectral-ct[compress]'") from None
    return hdf5plugin
