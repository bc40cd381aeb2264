"""Storage of the large arrays of a fit: in memory, or in memory-mapped files."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float32

from phantomgen.runtime.disk import check_free_space, one_sentence


class ArrayStore:
    """Maker of float32 arrays.

    Parameters
    ----------
    folder : folder of the memory-mapped files; None for memory
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def empty(self, name: str, shape: tuple[int, ...]) -> Float32[np.ndarray, "..."]:
        """Make an array without values.

        Parameters
        ----------
        name : name of its file, without suffix
        shape : shape of the array

        Returns
        -------
        the array

        Raises
        ------
        InputError
            When the disk has no room for it.
        """
        if self.folder is None:
            return np.empty(shape, np.float32)
        path = self.folder / f"{name}.npy"
        check_free_space(path, 4 * float(np.prod(shape)))
        with one_sentence(path):
            return np.lib.format.open_memmap(path, "w+", np.float32, shape)


IN_MEMORY = ArrayStore()


@contextmanager
def array_store(folder: Path, on_disk: bool) -> Iterator[ArrayStore]:
    """Open a store that is removed in the end, in a new folder inside `folder` where it is on disk.

    Parameters
    ----------
    folder : an existing folder
    on_disk : whether arrays are memory-mapped files
    """
    if not on_disk:
        yield IN_MEMORY
        return
    with TemporaryDirectory(prefix="arrays-", dir=folder, ignore_cleanup_errors=True) as name:
        yield ArrayStore(Path(name))


def read_part(array: Float32[np.ndarray, "..."], index: object) -> Float32[np.ndarray, "..."]:
    """Take a part of an array.

    Parameters
    ----------
    array : the array
    index : any index of numpy

    Returns
    -------
    the part; a copy where the array is in a file, whose pages are released
    """
    if not isinstance(array, np.memmap):
        return array[index]  # type: ignore[index]
    part = np.array(array[index])  # type: ignore[index]
    release(array)
    return part


def release(array: Float32[np.ndarray, "..."]) -> None:
    """Release the memory of an array in a file; the file keeps the values.

    Parameters
    ----------
    array : the array; nothing happens to one in memory
    """
    pages = getattr(array, "_mmap", None)
    if isinstance(pages, mmap.mmap):
        with suppress(AttributeError, OSError):  # systems without such advice do it when memory is short
            pages.madvise(mmap.MADV_DONTNEED)
