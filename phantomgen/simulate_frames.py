"""Writing the frames of a scan, view by view: computed in parallel, written in order, never many in memory."""

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import h5py
import numpy as np
from jaxtyping import Shaped

from phantomgen.dataset_layout import pack_image, write_image
from phantomgen.dataset_writer import DatasetWriter
from phantomgen.noise import Stream
from phantomgen.simulate_views import Views
from spectra.threads import run_parallel

Packed = list[list[bytes]]


def write_frames(writer: DatasetWriter, views: Views, keep_expected: bool, progress: bool) -> None:
    """Write all views and flats; darks stay zero, as an ideal detector counts nothing without beam."""
    scan = views.scan
    arrays = writer.new_counts(views.shape, scan.flats, scan.darks, scan.noise, scan.detector.units)
    kept = writer.new_expected(views.shape, scan.detector.units) if keep_expected else None

    def projection(view: int) -> tuple[Packed, Packed]:
        expected = views.expected(view)
        means = [image.astype(np.float32) for image in views.mean(expected)] if keep_expected else []
        return _packed(views.measured(expected, view)), _packed(means)

    def flat(frame: int) -> Packed:
        return _packed(views.measured(views.expected(frame, Stream.FLAT), frame, Stream.FLAT))

    for view, (counts, means) in _shown(projection, range(views.shape[0]), "views", progress):
        _put(arrays["data"], view, counts)
        if kept is not None:
            _put(kept, view, means)
    for frame, counts in _shown(flat, range(scan.flats), "flats", progress):
        _put(arrays["flat"], frame, counts)


def _packed(images: list[Shaped[np.ndarray, "row column"]]) -> Packed:
    """Images of all channels, ready for the file."""
    return [pack_image(image) for image in images]


def _put(dataset: h5py.Dataset, frame: int, packed: Packed) -> None:
    """Write all channels of one frame."""
    for channel, image in enumerate(packed):
        write_image(dataset, frame, channel, image)


def _shown(task: Callable[[int], Any], items: Iterable[int], name: str, progress: bool) -> Iterator[tuple[int, Any]]:
    """Results of `task` in order, computed in parallel, with a progress bar where somebody can see it."""
    from tqdm import tqdm  # noqa: PLC0415

    items = list(items)
    bar = tqdm(total=len(items), desc=name, unit="", leave=False, disable=None if progress else True)
    with bar:
        for item, result in zip(items, run_parallel(task, items), strict=True):
            bar.update()
            yield item, result
