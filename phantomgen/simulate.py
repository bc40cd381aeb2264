"""From a scan to its dataset: expected counts view by view, noise, truth, and an error measured on the way."""

import json
from pathlib import Path

from phantomgen.dataset_truth import Truth
from phantomgen.dataset_writer import DatasetWriter
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.planning import TOLERANCE, make_plan
from phantomgen.scene import Scan
from phantomgen.simulate_check import full_check, quick_check
from phantomgen.simulate_coverage import coverage_warnings
from phantomgen.simulate_frames import write_frames
from phantomgen.simulate_spectra import (
    fit_warnings,
    material_coefficients,
    material_fit,
    reconstructor_spectra,
)
from phantomgen.simulate_summary import Summary
from phantomgen.simulate_views import Views
from phantomgen.stopwatch import Stopwatch


def simulate(
    scan: Scan,
    out: Path | str,
    *,
    tolerance: float | None = None,
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
    tolerance : worst error of log projections that is wanted; by default `phantomgen.planning.TOLERANCE` as far as the
        scene allows
    overwrite : replace a file that exists
    keep_expected : store the counts without noise in the truth as well
    verify : measure the error on all edge pixels of three views, not on a sample
    progress : show a progress bar on stderr

    Returns
    -------
    what it took, and the error of the expected counts

    Raises
    ------
    InputError
        When a tolerance is given that cannot be met.
    """
    watch = Stopwatch()
    with DatasetWriter(out, overwrite) as writer:
        with watch("spectrum"):
            spectra = reconstructor_spectra(scan)
        with watch("plan"):
            plan = make_plan(scan, TOLERANCE if tolerance is None else tolerance)
            if tolerance is not None:
                plan.check()
            scan = plan.scan
            views = Views(scan, plan.exposure, plan.settings)
            warnings = [*plan.warnings, *coverage_warnings(scan), *fit_warnings(scan, material_fit(scan))]
            warnings += [*scan.detector.poor, *plan.exposure.warnings]
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
            error = (full_check if verify else quick_check)(scan, plan.exposure.transmission, plan.settings)
        writer.write_plan(json.dumps({**plan.to_dict(), "measured": error.to_dict()}, indent=1))
        writer.finish(spectra)
    return Summary(
        path=writer.path,
        shape=views.shape,
        size=writer.path.stat().st_size,
        seconds=watch.seconds,
        plan=plan,
        error=error,
        warnings=warnings,
    )


def scan_truth(scan: Scan) -> Truth:
    """Material fractions and basis volumes."""
    names = tuple(m.name for m in scan.scene.materials)
    filled = fractions(scan.grid, scan.scene.solids, len(names), background=scan.scene.background)
    coefficients, fit = material_coefficients(scan), material_fit(scan)
    return Truth.of(scan.grid, scan.basis.names, names, coefficients, filled, scan.text, fit)
