"""The frames of a scan: computed, kept in order in a journal, and put into the dataset from there.

Never many are in memory. An interrupted run goes on from the journal, with the first frame that is missing there.
"""

from collections.abc import Iterator

from phantomgen.dataset.layout import pack_image, write_image
from phantomgen.dataset.writing.frame_journal import Frame, FrameJournal, Packed
from phantomgen.dataset.writing.writer import DatasetWriter
from phantomgen.runtime.disk import check_free_space
from phantomgen.simulation.forward_model.detector import Frame as Images
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.readout import dark, flat, projections
from phantomgen.simulation.options import SimulationOptions
from phantomgen.simulation.projection_cache.cache import CacheWriter
from spectra.threads import run_parallel


def compute_frames(
    journal: FrameJournal, views: Views, options: SimulationOptions, cache_writer: CacheWriter | None = None
) -> None:
    """Compute all views, flats and darks that the journal lacks.

    Darks are computed only where the detector reads anything without beam.

    Parameters
    ----------
    journal : stores finished frames
    views : frames of the scan
    options : what is stored, how it is compressed, and whether a progress bar is shown on stderr
    cache_writer : stores projections at a few energies; None where they are not wanted
    """

    def packed(images: Images) -> Packed:
        return [pack_image(image, options.compression) for image in images]

    def view(number: int, counts: Images, means: Images) -> Frame:
        expected = {"expected": packed(means)} if options.keep_expected else {}
        return (
            {"data": packed(counts)}
            | expected
            | ({"paths": packed(cache_writer.images(number))} if cache_writer else {})
        )

    flats, darks = views.scan.flats, 0 if views.detector.reads_zero else views.scan.darks
    found = projections(views, view, options.keep_expected, journal.done("views"))
    _keep(journal, "views", found, views.shape[0], flats + darks, options.progress)
    found = run_parallel(lambda n: {"flat": packed(flat(views, n))}, range(journal.done("flats"), flats))
    _keep(journal, "flats", found, flats, darks, options.progress)
    found = run_parallel(lambda n: {"dark": packed(dark(views, n))}, range(journal.done("darks"), darks))
    _keep(journal, "darks", found, darks, 0, options.progress)


def write_frames(
    writer: DatasetWriter,
    views: Views,
    journal: FrameJournal,
    keep_expected: bool,
    cache_writer: CacheWriter | None = None,
) -> None:
    """Write all frames of a journal to the dataset; darks that are not in it stay zero.

    Parameters
    ----------
    writer : the dataset
    views : frames of the scan
    journal : stores finished frames
    keep_expected : write counts without noise as well
    cache_writer : writes projections at a few energies; None where they are not wanted
    """
    scan = views.scan
    arrays = writer.new_counts(views.shape, scan.flats, scan.darks, scan.noise, scan.detector.units)
    if keep_expected:
        arrays["expected"] = writer.new_expected(views.shape, scan.detector.units)
    if cache_writer:
        arrays["paths"] = cache_writer.new_array(writer.file, writer.compression)
    for _, number, frame in journal.frames():
        for name, images in frame.items():
            for channel, image in enumerate(images):
                write_image(arrays[name], number, channel, image)


def _keep(journal: FrameJournal, kind: str, frames: Iterator[Frame], count: int, later: int, progress: bool) -> None:
    """Add the frames of one kind that are missing, `later` more of other kinds being to come.

    Before the second one is begun, there has to be room for all that are missing, and for the dataset beside them.
    """
    first = journal.done(kind)
    for number, frame in enumerate(_shown(frames, first, count, kind, progress), first):
        missing = count - number + later
        needed = _size(frame) * (2 * missing + sum(journal.finished.values()))
        if number == first:
            check_free_space(journal.path, needed)
        journal.append(kind, number, frame, needed)


def _shown(frames: Iterator[Frame], first: int, count: int, name: str, progress: bool) -> Iterator[Frame]:
    """Yield the frames unchanged, with a progress bar on a terminal."""
    if not progress:
        yield from frames
        return
    from tqdm import tqdm  # noqa: PLC0415

    with tqdm(total=count, initial=first, desc=name, unit="", leave=False, disable=None) as bar:
        for frame in frames:
            yield frame
            bar.update()


def _size(frame: Frame) -> int:
    """Bytes of a packed frame."""
    return sum(len(chunk) for images in frame.values() for image in images for chunk in image)
