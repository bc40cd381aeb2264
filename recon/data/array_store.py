"""Where the large arrays of a fit live: in memory, or in files whose pages come and go."""

import mmap
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float32

from phantomgen.runtime.disk import check_room, one_sentence


class ArrayStore:
    """Makes float32 arrays.

    Parameters
    ----------
    folder : where their files are; None for memory
    """

    def __init__(self, folder: Path | None = None) -> None:
        self.folder = folder

    def empty(self, name: str, shape: tuple[int, ...]) -> Float32[np.ndarray, "..."]:
        """A new array.

        Raises
        ------
        InputError
            When the disk has no room for it.
        """
        if self.folder is None:
            return np.empty(shape, np.float32)
        path = self.folder / f"{name}.npy"
        check_room(path, 4 * float(np.prod(shape)))
        with one_sentence(path):
            return np.lib.format.open_memmap(path, "w+", np.float32, shape)


IN_MEMORY = ArrayStore()


@contextmanager
def array_store(folder: Path, on_disk: bool) -> Iterator[ArrayStore]:
    """A store that is removed in the end, in a new folder inside `folder` where it is on disk."""
    if not on_disk:
        yield IN_MEMORY
        return
    with TemporaryDirectory(prefix="arrays-", dir=folder, ignore_cleanup_errors=True) as name:
        yield ArrayStore(Path(name))


def taken(array: Float32[np.ndarray, "..."], index: object) -> Float32[np.ndarray, "..."]:
    """A part of an array; of one in a file a copy, and the pages that were read are let go."""
    if not isinstance(array, np.memmap):
        return array[index]  # type: ignore[index]
    part = np.array(array[index])  # type: ignore[index]
    release(array)
    return part


def release(array: Float32[np.ndarray, "..."]) -> None:
    """Let the pages of an array in a file go; the file keeps their content."""
    pages = getattr(array, "_mmap", None)
    if isinstance(pages, mmap.mmap):
        with suppress(AttributeError, OSError):  # systems without such advice do it when memory is short
            pages.madvise(mmap.MADV_DONTNEED)
