"""From a dataset to a worse one, view by view."""

import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from phantomgen.dataset.checks.door import find_array, group_at, has, value_at
from phantomgen.dataset.compression import Compression, check_compression
from phantomgen.dataset.file import FLAT
from phantomgen.dataset.layout import pack_image, text_of, write_image
from phantomgen.dataset.pixel_mask import write_mask
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.time.true_phases import read_signals, write_signals
from phantomgen.dataset.time.view_times import write_view_times
from phantomgen.dataset.truth import truth_group
from phantomgen.dataset.writing.corrected_copy import check_copy, file_digest
from phantomgen.dataset.writing.writer import DatasetWriter
from phantomgen.degradation.degraded_scan import DegradedScan, history
from phantomgen.degradation.settings import Degradation
from spectra.threads import run_parallel

# Parts of the truth that belong to views and pixels: written anew, or left out where they cannot be.
_OF_VIEWS = ("geometry", "motion", "time", "expected", "paths")
_BAR_AFTER = 2.0  # s

Frame = tuple[str, int, list[list[bytes]]]  # what it shows, its place, and the packed image of each channel


@dataclass(frozen=True)
class Degraded:
    """What was written.

    Parameters
    ----------
    path : the file
    shape : views, channels, rows, columns
    history : what was done, one phrase each
    """

    path: Path
    shape: tuple[int, ...]
    history: tuple[str, ...]


def degrade_file(
    path: Path | str,
    out: Path | str,
    settings: Degradation,
    *,
    overwrite: bool = False,
    compression: Compression = "gzip",
    progress: bool = False,
) -> Degraded:
    """Write a worse scan of a dataset. The output is complete or absent.

    Parameters
    ----------
    path : the dataset
    out : name of the new one
    settings : what is made worse
    overwrite : replace a file that exists
    compression : of large arrays
    progress : show a bar on stderr where it takes more than two seconds

    Returns
    -------
    what was written

    Raises
    ------
    InputError
        When the settings do not go with the dataset, or the output cannot be written.
    """
    path, out = Path(path), Path(out)
    check_writable(path, out, overwrite)
    check_compression(compression)
    with _opened(path) as dataset:
        scan = DegradedScan(dataset, settings, _steps(dataset) + 1)
        scan.check()
        done = tuple(history(scan))
        with DatasetWriter(out, overwrite, compression) as writer:
            _write_statements(writer, scan)
            _write_history(writer, scan, done)
            shape = _write_images(writer, scan, progress)
            _copy_truth(writer, scan)
            writer.finish(scan.stated[0])
    return Degraded(out, shape, done)


def check_writable(path: Path, out: Path, overwrite: bool) -> None:
    """Refuse an output that exists, is no dataset by its name, or is the scan itself.

    Parameters
    ----------
    path : the dataset that is read
    out : name of the new one
    overwrite : whether a file may be replaced

    Raises
    ------
    InputError
        When it cannot be written.
    """
    check_copy(path, out, overwrite)


def level_path(out: Path, level: float) -> Path:
    """Return the name of the file of one dose.

    Parameters
    ----------
    out : name that was given
    level : the dose

    Returns
    -------
    the name with the dose before its suffix
    """
    return out.with_name(f"{out.stem}-{level:g}{out.suffix}")


def _opened(path: Path) -> Dataset:
    """Open a dataset, also one without flats."""
    anywhere = (slice(0, 1), slice(0, 1))
    dataset = open_dataset(path, air=anywhere, as_stored=True)
    flats = find_array(dataset.file, FLAT)
    if flats is None or not flats.shape[0]:
        return dataset
    dataset.close()
    return open_dataset(path, as_stored=True)


def _steps(dataset: Dataset) -> int:
    """Number of processes in the history of a file."""
    return len([name for name in group_at(dataset.file, "entry") if str(name).startswith("process_")])


def _write_statements(writer: DatasetWriter, scan: DegradedScan) -> None:
    """All that a reconstructor may know but for images."""
    dataset, geometry, spectra = scan.dataset, scan.geometry, scan.stated[0]
    views, splits = scan.kept
    stored = group_at(dataset.file, "/entry/splits")
    scheme = text_of(stored.attrs.get("default", next(iter(stored), "")))
    chosen = len(views) < dataset.counts.shape[0]
    new_name = f"{len(splits['train'])}_of_{len(dataset.splits['train'])}"
    writer.write_scan(
        dataset.name, geometry, spectra, dataset.grid, splits, new_name if chosen else scheme, scan.exposure
    )
    for other in stored:
        if not chosen and other != scheme:
            dataset.file.copy(stored[other], group_at(writer.file, "/entry/splits"), other)
    if dataset.view_times is not None:
        write_view_times(group_at(writer.file, "entry"), dataset.view_times[views])
    writer.write_instrument(geometry, spectra, scan.source_fields)
    for name, mask in zip(spectra.channels, scan.masks, strict=True):
        write_mask(writer.file, (name,), mask)


def _write_history(writer: DatasetWriter, scan: DegradedScan, done: tuple[str, ...]) -> None:
    """Copy what was done to the file before, and add this step."""
    entry = group_at(scan.dataset.file, "entry")
    for name in entry:
        if str(name).startswith("process_"):
            scan.dataset.file.copy(entry[name], group_at(writer.file, "entry"), name)
    settings = json.dumps(
        {**asdict(scan.settings), "scan": scan.dataset.path.name, "sha256": file_digest(scan.dataset.path)}
    )
    writer.write_step("degrade", scan.step, scan.settings.seed, done, settings)


def _write_images(writer: DatasetWriter, scan: DegradedScan, progress: bool) -> tuple[int, ...]:
    """Write all frames, few of them in memory at once; returns the shape of the counts."""
    panel, channels = scan.geometry.panel, len(scan.dataset.spectra.channels)
    numbers = {kind: scan.frames(kind) for kind in ("data", "flat", "dark")}
    shape = (len(numbers["data"]), channels, panel.rows, panel.columns)
    units = scan.dataset.spectra.units
    arrays = writer.new_counts(shape, len(numbers["flat"]), len(numbers["dark"]), scan.writes_counts, units)
    places = [(kind, place, int(frame)) for kind, frames in numbers.items() for place, frame in enumerate(frames)]
    if has(scan.dataset.file, "truth/expected"):
        arrays["expected"] = writer.new_expected(shape, units)
        places += [("expected", place, int(frame)) for place, frame in enumerate(numbers["data"])]

    def packed(item: tuple[str, int, int]) -> Frame:
        kind, place, frame = item
        images = scan.expected(frame) if kind == "expected" else scan.images(kind, frame)
        return kind, place, [pack_image(image, writer.compression) for image in images]

    _ = scan.dataset.dark, scan.dataset.mask, scan.dataset.dark_variance, scan.is_noise_free  # before threads need them
    for kind, place, images in _shown(run_parallel(packed, places), len(places), progress):
        for channel, image in enumerate(images):
            write_image(arrays[kind], place, channel, image)
    return shape


def _copy_truth(writer: DatasetWriter, scan: DegradedScan) -> None:
    """Copy the truth; what belongs to views follows them."""
    file = scan.dataset.file
    if not has(file, "truth"):
        return
    old, new = group_at(file, "truth"), truth_group(writer.file)
    for name in old:
        if name not in _OF_VIEWS:
            file.copy(old[name], new, name)
    if scan.has_true_geometry:
        poses = value_at(file, "truth/motion/pose")[scan.kept[0]] if has(file, "truth/motion/pose") else None
        writer.write_true_geometry(scan.true_geometry, poses)
    if has(file, "truth/time"):
        signals = read_signals(scan.dataset.path)
        write_signals(new, {name: values[scan.kept[0]] for name, values in signals.items()})


def _shown(frames: Iterator[Frame], count: int, progress: bool) -> Iterator[Frame]:
    """Yield the frames unchanged, with a progress bar on a terminal."""
    if not progress:
        yield from frames
        return
    from tqdm import tqdm  # noqa: PLC0415

    with tqdm(total=count, desc="frames", unit="", leave=False, disable=None, delay=_BAR_AFTER) as bar:
        for frame in frames:
            yield frame
            bar.update()
