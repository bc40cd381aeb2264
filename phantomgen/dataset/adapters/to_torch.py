"""Views for training: a map-style dataset of torch that every worker opens for itself."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import Dataset as TorchDataset

from phantomgen.dataset.reader import Dataset, Region, open_dataset
from spectra.errors import InputError


class ViewSet(TorchDataset):
    """Views of a dataset as a map-style dataset of torch.

    An item is a dict with ``counts`` and ``line_integrals``, float32 tensors (channel, row, column), and ``view``, its
    number. The file is opened when the first item is read, in each process anew, as open files do not survive a fork.

    Parameters
    ----------
    path : of the dataset
    views : numbers of the views
    air : a part of the panel that sees only air, for lack of flats
    """

    def __init__(self, path: Path, views: Sequence[int], air: Region | None = None) -> None:
        self.path, self.views, self.air = Path(path), tuple(int(view) for view in views), air
        self._opened: tuple[int, Dataset] | None = None

    @classmethod
    def of(cls, dataset: Dataset, split: str = "train") -> "ViewSet":
        """Create the view set of a split of an open dataset.

        Parameters
        ----------
        dataset : open dataset
        split : ``train``, ``test``, ``val``, or ``all`` for all views

        Returns
        -------
        the view set

        Raises
        ------
        InputError
            When there is no such split.
        """
        known = {**dataset.splits, "all": range(dataset.counts.shape[0])}
        if split not in known:
            raise InputError(f"there is no split {split!r}: choose from {', '.join(known)}")
        return cls(dataset.path.absolute(), [int(view) for view in known[split]], dataset.air)

    def __len__(self) -> int:
        return len(self.views)

    def __repr__(self) -> str:
        return f"ViewSet({self.path.name}: {len(self)} views)"

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Item of a place in the split."""
        view, dataset = self.views[index], self._dataset()
        counts = torch.from_numpy(dataset.load([view])[0]).float()
        return {"counts": counts, "line_integrals": torch.from_numpy(dataset.line_integrals(view)), "view": view}

    def close(self) -> None:
        """Close the file if this process has it open; the next item opens it again."""
        if self._opened is not None and self._opened[0] == os.getpid():
            self._opened[1].close()
        self._opened = None

    def __getstate__(self) -> dict[str, Any]:
        """Without the open file."""
        return {**vars(self), "_opened": None}

    def _dataset(self) -> Dataset:
        """The file, opened by this process."""
        if self._opened is None or self._opened[0] != os.getpid():
            self._opened = os.getpid(), open_dataset(self.path, self.air)
        return self._opened[1]
