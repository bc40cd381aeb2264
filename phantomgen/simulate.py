"""From a scan to its dataset: expected counts view by view, noise, truth, and an error measured on the way."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset_layout import pack_image, write_image
from phantomgen.dataset_truth import Truth
from phantomgen.dataset_writer import DatasetWriter
from phantomgen.noise import Stream
from phantomgen.ops.expose import expose
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.scene import Scan
from phantomgen.simulate_check import MeasuredError, full_check, quick_check
from phantomgen.simulate_coverage import coverage_warnings, sampled_lengths
from phantomgen.simulate_noise import Exposure, Images
from phantomgen.simulate_spectra import (
    fit_warnings,
    material_coefficients,
    material_fit,
    reconstructor_spectra,
)
from phantomgen.stopwatch import Stopwatch
from spectra.threads import run_parallel
from spectra.transmission import Transmission

Packed = list[list[bytes]]


@dataclass(frozen=True)
class Summary:
    """What a simulation made, what it took, and how wrong it is.

    Parameters
    ----------
    path : the dataset
    shape : views, channels, rows, columns
    size : of the file [byte]
    seconds : wall time per stage
    nodes : energy nodes per channel
    node_error : worst error of log counts that few nodes instead of many bins add
    error : expected counts against brute force
    warnings : sentences about what the scan cuts off
    """

    path: Path
    shape: tuple[int, int, int, int]
    size: int
    seconds: dict[str, float]
    nodes: tuple[int, ...]
    node_error: float
    error: MeasuredError
    warnings: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: all numbers under stable keys."""
        return {
            "path": str(self.path),
            "shape": list(self.shape),
            "bytes": self.size,
            "seconds": {**self.seconds, "total": sum(self.seconds.values())},
            "nodes": list(self.nodes),
            "node_error": self.node_error,
            "error": self.error.to_dict(),
            "warnings": self.warnings,
        }

    @property
    def text(self) -> str:
        """For people."""
        views, channels, rows, columns = self.shape
        stages = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in self.seconds.items())
        return "\n".join(
            [
                f"{self.path}: {views} views x {channels} channels x {rows} x {columns}, {self.size / 1e6:.1f} MB",
                f"time     {sum(self.seconds.values()):.1f} s: {stages}",
                f"energies {' + '.join(map(str, self.nodes))} nodes, worst log error {self.node_error:.1e}",
                f"error    {self.error}",
                f"next     recon fit {self.path}",
            ]
        )


def simulate(
    scan: Scan,
    out: Path | str,
    *,
    overwrite: bool = False,
    keep_expected: bool = False,
    verify: bool = False,
    progress: bool = False,
) -> Summary:
    """Simulate a scan and write its dataset.

    Parameters
    ----------
    scan : what is scanned, with what
    out : name of the dataset; it appears there when complete
    overwrite : replace a file that exists
    keep_expected : store the counts without noise in the truth as well
    verify : measure the error on all edge pixels of three views, not on a sample
    progress : show a progress bar on stderr

    Returns
    -------
    what it took, and the error of the expected counts
    """
    watch = Stopwatch()
    with DatasetWriter(out, overwrite) as writer:
        with watch("spectrum"):
            exposure, node_error = Exposure.of(scan, sampled_lengths(scan))
            spectra = reconstructor_spectra(scan)
            warnings = [*coverage_warnings(scan), *fit_warnings(scan, material_fit(scan))]
            warnings += [*scan.detector.poor, *exposure.warnings]
        writer.write_scan(scan.name, scan.geometry, spectra, scan.grid, dict(scan.splits), scan.scheme, scan.exposure)
        writer.write_instrument(scan.geometry, spectra, dict(scan.source_fields))
        writer.write_process("phantomgen make", scan.seed)
        with watch("views"):
            _write_counts(writer, scan, exposure, keep_expected, progress)
        with watch("truth"):
            writer.write_truth(scan_truth(scan), scan.scene.materials)
        with watch("check"):
            error = (full_check if verify else quick_check)(scan, exposure.transmission)
        writer.finish(spectra)
    return Summary(
        path=writer.path,
        shape=_shape(scan),
        size=writer.path.stat().st_size,
        seconds=watch.seconds,
        nodes=tuple(b - a for a, b in pairwise(exposure.transmission.starts.tolist())),
        node_error=node_error,
        error=error,
        warnings=warnings,
    )


def expected_view(scan: Scan, transmission: Transmission, view: int) -> Images:
    """Expected counts of one view and channel (or group of photons), averaged over each pixel's area."""
    panel = scan.geometry.panel
    return expose(
        scan.geometry.ray_frames()[view],
        panel.rows,
        panel.columns,
        scan.scene.solids,
        transmission.columns,
        transmission.weights,
        transmission.starts,
        scan.scene.background,
        sub_rays=scan.sub_rays,
        profile=None if scan.profile is None else scan.profile.lengths,
    ).counts


def open_beam(scan: Scan, transmission: Transmission) -> Images:
    """Expected counts of one view without any object."""
    pixels = _shape(scan)[2:]
    if scan.profile is None:
        return np.broadcast_to(transmission.open_beam[:, None, None], (len(transmission), *pixels))
    lengths = np.zeros((*pixels, len(transmission.columns)))
    lengths[:, :, -len(scan.profile.names) :] = np.moveaxis(scan.profile.lengths, 0, -1)
    return np.moveaxis(transmission.expected(lengths), -1, 0)


def _shape(scan: Scan) -> tuple[int, int, int, int]:
    """Views, channels, rows, columns."""
    return len(scan.geometry), len(scan.detector), scan.geometry.panel.rows, scan.geometry.panel.columns


def scan_truth(scan: Scan) -> Truth:
    """Material fractions and basis volumes."""
    names = tuple(m.name for m in scan.scene.materials)
    filled = fractions(scan.grid, scan.scene.solids, len(names), background=scan.scene.background)
    coefficients, fit = material_coefficients(scan), material_fit(scan)
    return Truth.of(scan.grid, scan.basis.names, names, coefficients, filled, scan.text, fit)


def _write_counts(writer: DatasetWriter, scan: Scan, exposure: Exposure, keep_expected: bool, progress: bool) -> None:
    """Expose all views and flats; darks stay zero, as an ideal detector counts nothing without beam."""
    shape = _shape(scan)
    arrays = writer.new_counts(shape, scan.flats, scan.darks, scan.noise, scan.detector.units)
    kept = writer.new_expected(shape, scan.detector.units) if keep_expected else None

    def projection(view: int) -> tuple[Packed, Packed]:
        expected = expected_view(scan, exposure.groups, view)
        if scan.exposure is not None:
            expected *= scan.exposure[view][exposure.channels][:, None, None]
        kept = _packed_means(exposure.mean(expected)) if keep_expected else []
        return _packed(scan, exposure, expected, view, Stream.PROJECTION), kept

    without_object = open_beam(scan, exposure.groups)

    def flat(frame: int) -> Packed:
        return _packed(scan, exposure, without_object, frame, Stream.FLAT)

    for view, (counts, means) in _shown(projection, range(shape[0]), "views", progress):
        _put(arrays["data"], view, counts)
        if kept is not None:
            _put(kept, view, means)
    for frame, counts in _shown(flat, range(scan.flats), "flats", progress):
        _put(arrays["flat"], frame, counts)


def _packed(scan: Scan, exposure: Exposure, expected: Images, frame: int, stream: Stream) -> Packed:
    """Counts of one frame, ready for the file."""
    if not scan.noise:
        return _packed_means(exposure.mean(expected))
    return [pack_image(image) for image in exposure.noisy(expected, scan.seed, frame, stream)]


def _packed_means(mean: Images) -> Packed:
    """Counts without noise, ready for the file."""
    return [pack_image(image.astype(np.float32)) for image in mean]


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
