"""Several scans as data sets of torch: one item per view or one item per scan; files are opened in each worker."""

from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset as TorchDataset

from phantomgen.dataset.adapters.to_torch import ViewSet
from phantomgen.dataset.reader import Region, open_dataset
from phantomgen.dataset.truth import read_truth
from spectra.errors import InputError

# Files that a process keeps open at once.
_MOST_OPEN = 16


class ScanViews(TorchDataset):
    """Views of several scans as a map-style data set: all views of the first file, then those of the second.

    An item is that of a `ViewSet`, ``counts``, ``line_integrals`` and ``view``, and ``scan``, the number of the file. A
    process keeps 16 files open at most. Items depend on their number alone, so that any number of workers gives the
    same ones.

    Parameters
    ----------
    paths : of the datasets
    split : ``train``, ``test``, ``val``, or ``all`` for all views
    air : a part of the panel that sees only air, for lack of flats

    Raises
    ------
    InputError
        When there is no file, or no such split.
    """

    def __init__(self, paths: Sequence[Path | str], split: str = "train", air: Region | None = None) -> None:
        self.sets = []
        for path in _known(paths):
            with open_dataset(path, air) as dataset:
                self.sets.append(ViewSet.of(dataset, split))
        self.ends = np.cumsum([len(views) for views in self.sets]).tolist()
        self._open: OrderedDict[int, None] = OrderedDict()

    def __len__(self) -> int:
        return self.ends[-1]

    def __repr__(self) -> str:
        return f"ScanViews({len(self.sets)} scans, {len(self)} views)"

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Item of a view."""
        if not -len(self) <= index < len(self):
            raise IndexError(f"there are {len(self)} views, there is no view {index}")
        index %= len(self)
        scan = bisect_right(self.ends, index)
        item = self.sets[scan][index - self.ends[scan]]
        self._open[scan] = None
        self._open.move_to_end(scan)
        while len(self._open) > _MOST_OPEN:
            self.sets[self._open.popitem(last=False)[0]].close()
        return {**item, "scan": scan}

    def __getstate__(self) -> dict[str, Any]:
        """Without open files."""
        return {**vars(self), "_open": OrderedDict()}


class ScanSet(TorchDataset):
    """Whole scans as a map-style data set, to train networks that reconstruct: one item per file.

    An item is a dict with ``counts`` and ``line_integrals``, float32 tensors (view, channel, row, column), ``truth``,
    the true coefficients of the basis functions [1/mm], a float32 tensor (basis, z, y, x) where the file has them, and
    ``scan``, its number. A file is opened for its item and closed again. Batches of more than one scan need scans of
    equal shape.

    Parameters
    ----------
    paths : of the datasets
    split : ``train``, ``test``, ``val``, or ``all`` for all views
    air : a part of the panel that sees only air, for lack of flats

    Raises
    ------
    InputError
        When there is no file.
    """

    def __init__(self, paths: Sequence[Path | str], split: str = "train", air: Region | None = None) -> None:
        self.paths, self.split, self.air = _known(paths), split, air

    def __len__(self) -> int:
        return len(self.paths)

    def __repr__(self) -> str:
        return f"ScanSet({len(self)} scans)"

    def __getitem__(self, index: int) -> dict[str, Any]:
        """Item of a scan."""
        path = self.paths[index]
        with open_dataset(path, self.air) as dataset:
            views = ViewSet.of(dataset, self.split).views
            counts = torch.from_numpy(dataset.load(views)).float()
            lines = np.stack([dataset.line_integrals(view) for view in views])
        item = {"counts": counts, "line_integrals": torch.from_numpy(lines), "scan": index % len(self)}
        truth = read_truth(path)
        return item if truth is None else {**item, "truth": torch.from_numpy(truth.volumes)}

    def views(self) -> ScanViews:
        """Return the single views of these scans.

        Returns
        -------
        data set with one item per view
        """
        return ScanViews(self.paths, self.split, self.air)


def _known(paths: Sequence[Path | str]) -> list[Path]:
    """Absolute paths, which workers find wherever they run."""
    if isinstance(paths, str | Path):
        raise InputError(f"paths must be a list of files, got {str(paths)!r}: write [{str(paths)!r}]")
    if not paths:
        raise InputError("a set of scans needs one file at least, got an empty list")
    return [Path(path).absolute() for path in paths]
