"""HDF5 files that end in one sentence on a full disk, where HDF5 itself crashes when it closes a file."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py

from phantomgen.runtime.disk import one_sentence


class _PatientFile(io.FileIO):
    """A file that remembers the first error of the file system, and takes everything after it for written."""

    failure: OSError | None = None

    def write(self, data: Any, /) -> int:
        """Write all bytes, or remember why not."""
        rest = memoryview(data).cast("B")
        size = len(rest)
        while len(rest) and self.failure is None:
            try:
                rest = rest[super().write(rest) or 0 :]
            except OSError as error:
                self.failure = error
        return size

    def readinto(self, buffer: Any, /) -> int:
        """Read; zeros where nothing could be written."""
        target = memoryview(buffer).cast("B")
        count = super().readinto(target) or 0
        target[count:] = bytes(len(target) - count)
        return len(target)

    def truncate(self, size: int | None = None, /) -> int:
        """Set the length, or remember why not."""
        try:
            return super().truncate(size)
        except OSError as error:
            self.failure = self.failure or error
            return size or 0


@contextmanager
def hdf5_output(path: Path) -> Iterator[h5py.File]:
    """Create an HDF5 file; a context manager.

    Parameters
    ----------
    path : name of the file

    Yields
    ------
    the open file

    Raises
    ------
    StorageError
        When the disk is full or refuses; then no file is left.
    """
    with one_sentence(path), _PatientFile(path, "w+") as raw:
        try:
            with h5py.File(raw, "w") as file:
                yield file
        except BaseException:
            if raw.failure is None:
                raise
        if raw.failure is not None:
            raw.truncate(0)
            path.unlink(missing_ok=True)
            raise raw.failure
