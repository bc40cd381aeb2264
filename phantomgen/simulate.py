"""From a scan to its dataset: expected counts view by view, noise, truth, and an error measured on the way."""

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

from phantomgen.dataset_truth import Truth
from phantomgen.dataset_writer import DatasetWriter
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.scene import Scan
from phantomgen.settings import Settings
from phantomgen.simulate_check import MeasuredError, full_check, quick_check
from phantomgen.simulate_coverage import coverage_warnings, sampled_lengths
from phantomgen.simulate_frames import write_frames
from phantomgen.simulate_noise import Exposure
from phantomgen.simulate_spectra import (
    fit_warnings,
    material_coefficients,
    material_fit,
    reconstructor_spectra,
)
from phantomgen.simulate_views import Views
from phantomgen.stopwatch import Stopwatch


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
    watch, settings = Stopwatch(), Settings(sub_rays=scan.sub_rays)
    with DatasetWriter(out, overwrite) as writer:
        with watch("spectrum"):
            exposure, node_error = Exposure.of(scan, sampled_lengths(scan))
            views = Views(scan, exposure, settings)
            spectra = reconstructor_spectra(scan)
            warnings = [*coverage_warnings(scan), *fit_warnings(scan, material_fit(scan))]
            warnings += [*scan.detector.poor, *exposure.warnings]
        writer.write_scan(
            scan.name, scan.geometry, spectra, scan.grid, dict(scan.splits), scan.scheme, views.recorded_exposure
        )
        writer.write_instrument(scan.geometry, spectra, dict(scan.source_fields))
        writer.write_process("phantomgen make", scan.seed)
        with watch("views"):
            write_frames(writer, views, keep_expected, progress)
        with watch("truth"):
            writer.write_truth(scan_truth(scan), scan.scene.materials)
        with watch("check"):
            error = (full_check if verify else quick_check)(scan, exposure.transmission)
        writer.finish(spectra)
    return Summary(
        path=writer.path,
        shape=views.shape,
        size=writer.path.stat().st_size,
        seconds=watch.seconds,
        nodes=tuple(b - a for a, b in pairwise(exposure.transmission.starts.tolist())),
        node_error=node_error,
        error=error,
        warnings=warnings,
    )


def scan_truth(scan: Scan) -> Truth:
    """Material fractions and basis volumes."""
    names = tuple(m.name for m in scan.scene.materials)
    filled = fractions(scan.grid, scan.scene.solids, len(names), background=scan.scene.background)
    coefficients, fit = material_coefficients(scan), material_fit(scan)
    return Truth.of(scan.grid, scan.basis.names, names, coefficients, filled, scan.text, fit)
