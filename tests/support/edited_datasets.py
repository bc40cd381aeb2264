"""Datasets that a test edits on purpose, so that their digests must follow."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py

from phantomgen.dataset.checks.digest import seal


@contextmanager
def edited_dataset(path: Path | str) -> Iterator[h5py.File]:
    """Open a dataset for changes that its digests accept."""
    with h5py.File(path, "r+") as file:
        yield file
        seal(file)
