"""From a scan to its dataset: expected counts view by view, noise, truth, and an error measured on the way."""

import json
from pathlib import Path
from typing import Any

from phantomgen.dataset.compression import check_compression
from phantomgen.dataset.writing.frame_journal import FrameJournal, check_journal
from phantomgen.dataset.writing.writer import DatasetWriter
from phantomgen.runtime.named_options import named_options
from phantomgen.runtime.stopwatch import Stopwatch
from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.collisions import check_collisions
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from phantomgen.simulation.checks.verification import full_check, quick_check
from phantomgen.simulation.forward_model.energy_grids import (
    basis_warnings,
    fit_warnings,
    material_fit,
    reconstructor_spectra,
)
from phantomgen.simulation.forward_model.fingerprint import identity
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.truth import streamed_truth
from phantomgen.simulation.options import SimulationOptions
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import TOLERANCE
from phantomgen.simulation.projection_cache.cache import CacheWriter, usable
from phantomgen.simulation.summary import Summary
from phantomgen.simulation.write_frames import compute_frames, write_frames
from spectra.errors import InputError


@named_options(SimulationOptions)
def simulate(scan: Scan, out: Path | str, **options: Any) -> Summary:
    """Simulate a scan and write its dataset.

    Parameters
    ----------
    scan : what is scanned, with what
    out : name of the dataset; it appears there when complete
    **options : fields of `phantomgen.simulation.options.SimulationOptions`, such as ``tolerance=1e-4``,
        ``overwrite=True`` or ``keep_expected=True``

    Returns
    -------
    what it took, and the error of the expected counts

    Raises
    ------
    GeometryError
        When an object lies behind the source, or where the panel is.
    InputError
        When a tolerance is given that cannot be met, or projections are those of another scan.
    """
    return _simulate(scan, out, SimulationOptions(**options))


def _simulate(scan: Scan, out: Path | str, options: SimulationOptions) -> Summary:
    """Simulate a scan and write its dataset."""
    if scan.dynamics is not None and (options.keep_paths or options.paths is not None):
        raise InputError("projections of a scene with `time` are not kept: leave out --keep paths and --paths")
    kept = None if options.paths is None else usable(options.paths, scan, out, options.keep_paths)
    check_collisions(scan)
    watch = Stopwatch(options.on_stage)
    writer = DatasetWriter(out, options.overwrite, options.compression)
    check_journal(writer.path, options.resume, options.overwrite)
    check_compression(options.compression)
    with watch("spectrum"):
        spectra = reconstructor_spectra(scan)
    with watch("plan"):
        wanted = TOLERANCE if options.tolerance is None else options.tolerance
        plan, cached_views = (make_plan(scan, wanted), None) if kept is None else kept.planned(scan, wanted)
        if options.tolerance is not None:
            plan.check()
        scan = plan.scan
        views = Views(scan, plan.exposure, plan.settings, cached=cached_views.primary if cached_views else None)
        cache_writer = CacheWriter.of(plan) if options.keep_paths else None
        warnings = [*plan.warnings, *coverage_warnings(scan), *basis_warnings(scan)]
        warnings += [*fit_warnings(scan, material_fit(scan)), *scan.detector.model_warnings]
        warnings += [*plan.exposure.warnings, *views.detector.warnings]
    nominal = scan.nominal or scan.geometry
    stored = options.stored if kept is None else {**options.stored, "projections": kept.identity}
    same = identity(scan, plan.settings, plan.exposure.groups, stored)
    with FrameJournal(writer.path, same, options.resume, options.overwrite) as journal:
        with watch("views"):
            compute_frames(journal, views, options, cache_writer)
        with writer:
            writer.write_scan(
                scan.name, nominal, spectra, scan.grid, dict(scan.splits), scan.scheme, views.recorded_exposure
            )
            writer.write_instrument(nominal, spectra, dict(scan.source_fields))
            writer.write_mask(spectra.channels, views.detector.recorded_mask)
            writer.write_process("phantomgen make", scan.seed)
            with watch("write"):
                write_frames(writer, views, journal, options.keep_expected, cache_writer)
            with watch("truth"):
                filled = None if kept is None else kept.fractions(scan)
                writer.write_truth(streamed_truth(scan, filled), scan.scene.materials)
                if scan.dynamics is not None:
                    from phantomgen.simulation.forward_model.view_times import view_times  # noqa: PLC0415 - seldom

                    writer.write_time(*view_times(scan.dynamics))
                if scan.nominal is not None:
                    writer.write_true_geometry(scan.geometry, scan.sample_poses)
            with watch("check"):
                check, primary = full_check if options.verify else quick_check, None if kept is None else views.primary
                error = check(scan, plan.exposure.transmission, plan.settings, primary)
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
