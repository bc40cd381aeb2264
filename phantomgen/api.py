"""Short interface for Python: scenes to plans and datasets, scans of others to datasets, datasets to changed ones."""

import weakref
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import Any

import numpy as np
from jaxtyping import Shaped

from phantomgen.building.scene import Scene
from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.writing.writer import check_dataset_name
from phantomgen.degradation.settings import Degradation
from phantomgen.importers.formats import import_scan as write_imported
from phantomgen.importers.scans.finish import Wanted
from phantomgen.importers.scans.stated import Stated
from phantomgen.runtime.named_options import named_options
from phantomgen.scene.file.scene_file import Overrides
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.options import SimulationOptions
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import TOLERANCE, Plan
from phantomgen.simulation.projection_cache.cache import cached_scene
from phantomgen.simulation.run import simulate

Scannable = Scan | Scene | str | Path


def load(scene: Scene | str | Path, overrides: Overrides = ()) -> Scan:
    """Read a scene and create its scan.

    Parameters
    ----------
    scene : path of a scene file, name of a preset, or a scene built in Python
    overrides : values by dotted path, such as ``{"geometry.views": 30}``, or texts such as ``geometry.views=30``

    Returns
    -------
    the scan

    Raises
    ------
    SceneError
        With file, line, column and key of what is wrong.
    """
    return load_scene(scene.file if isinstance(scene, Scene) else scene, overrides)


def plan(scan: Scannable, *, tolerance: float = TOLERANCE) -> Plan:
    """Choose how finely a scan will be computed, and measure the error.

    Parameters
    ----------
    scan : what to simulate: a scan, a scene, or a preset or scene file
    tolerance : worst error of log projections that is wanted

    Returns
    -------
    the plan
    """
    return make_plan(_scan(scan), tolerance)


def make(
    scan: Scannable,
    out: Path | str | None = None,
    *,
    seed: int | None = None,
    tolerance: float | None = None,
    overwrite: bool = False,
    keep_paths: bool = False,
    progress: bool = False,
    options: SimulationOptions | None = None,
) -> Dataset:
    """Simulate a scan and open its dataset.

    Parameters
    ----------
    scan : what to simulate: a scan, a scene, or a preset or scene file
    out : name of the dataset; a temporary file, removed when the dataset is closed, where left out
    seed : of the noise; that of the scene where left out
    tolerance : worst error of log projections that is wanted
    overwrite : replace a file that exists
    keep_paths : keep what `again` needs to scan with other spectra, doses and seeds without tracing rays
    progress : show a progress bar
    options : further options, such as ``SimulationOptions(keep_expected=True)``

    Returns
    -------
    the dataset, to be closed or used in a ``with`` statement
    """
    scan = _scan(scan)
    if seed is not None:
        scan = replace(scan, seed=seed)
    given = {"tolerance": tolerance, "overwrite": overwrite, "keep_paths": keep_paths, "progress": progress}
    asked = {name: value for name, value in given.items() if value not in (None, False)}
    return _made(scan, out, replace(options or SimulationOptions(), **asked))


def again(
    dataset: Dataset | str | Path,
    changes: Overrides,
    out: Path | str | None = None,
    *,
    overwrite: bool = False,
) -> Dataset:
    """Scan once more with another spectrum, dose, thresholds or seed, without tracing rays again.

    Parameters
    ----------
    dataset : made with ``keep_paths=True``, or its name
    changes : values by dotted path, such as ``{"source.kvp": 100, "seed": 1}``
    out : name of the new dataset; a temporary file, removed when the dataset is closed, where left out
    overwrite : replace a file that exists

    Returns
    -------
    the new dataset, to be closed or used in a ``with`` statement

    Raises
    ------
    DatasetError
        When the dataset does not keep its projections.
    InputError
        When objects, materials, geometry or panel are changed, which need rays.
    """
    path = dataset.path if isinstance(dataset, Dataset) else Path(dataset)
    scan = load_scene(cached_scene(path).changed(changes))
    return _made(scan, out, SimulationOptions(paths=path, overwrite=overwrite))


@named_options(Degradation)
def degrade(
    dataset: Dataset | str | Path,
    out: Path | str,
    settings: Degradation | None = None,
    *,
    overwrite: bool = False,
    **options: Any,
) -> Dataset:
    """Write a scan made worse, with less dose, fewer views or a wrong statement, and open it.

    Parameters
    ----------
    dataset : the scan, or its name
    out : name of the new dataset
    settings : what is made worse; the options below replace its fields
    overwrite : replace a file that exists
    **options : fields of `phantomgen.degradation.settings.Degradation`, such as ``dose=0.25``; they replace those of
        `settings`

    Returns
    -------
    the new dataset, to be closed or used in a ``with`` statement
    """
    from phantomgen.degradation.run import degrade_file  # noqa: PLC0415 - as for `correct`

    path = dataset.path if isinstance(dataset, Dataset) else Path(dataset)
    wanted = replace(settings or Degradation(), **options)
    return open_dataset(degrade_file(path, out, wanted, overwrite=overwrite).path)


def correct(
    dataset: Dataset | str | Path,
    out: Path | str,
    steps: Sequence[str] = ("defects", "drift", "rings"),
    *,
    flats: Shaped[np.ndarray, "frame channel row column"] | None = None,
    darks: Shaped[np.ndarray, "frame channel row column"] | None = None,
    overwrite: bool = False,
) -> Dataset:
    """Write a raw scan with bad pixels masked, and tube output and gains of pixels corrected, and open it.

    Parameters
    ----------
    dataset : the scan, or its name
    out : name of the new dataset
    steps : what is corrected: ``defects``, ``drift`` and ``rings``
    flats, darks : frames that replace those of the scan, (frame, channel, row, column)
    overwrite : replace a file that exists

    Returns
    -------
    the new dataset, to be closed or used in a ``with`` statement; its counts are those of the scan
    """
    from phantomgen.correction.run import Wanted, correct_file  # noqa: PLC0415 - scipy takes half a second

    path = dataset.path if isinstance(dataset, Dataset) else Path(dataset)
    return open_dataset(correct_file(path, out, Wanted(tuple(steps), flats, darks), overwrite=overwrite).path)


@named_options(Stated, Wanted)
def import_scan(
    name: str,
    paths: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    title: str | None = None,
    overwrite: bool = False,
    **options: Any,
) -> Dataset:
    """Write the dataset of a scan of another program or of a scanner, and open it.

    Parameters
    ----------
    name : of the format, one of those of `phantomgen import`, such as ``nikon``
    paths : of the scan; several are channels, where the format has one file per channel
    out : name of the dataset
    title : of the scan; that of the file where left out
    overwrite : replace a file that exists
    **options : facts that no file states, then what is to be written

    Returns
    -------
    the dataset, to be closed or used in a ``with`` statement
    """
    listed = [paths] if isinstance(paths, Path | str) else paths
    done = write_imported(name, [Path(path) for path in listed], Path(out), title=title, overwrite=overwrite, **options)
    return open_dataset(done.path)


def _scan(scan: Scannable) -> Scan:
    if isinstance(scan, Scan):
        return scan
    return scan.scan if isinstance(scan, Scene) else load_scene(scan)


def _made(scan: Scan, out: Path | str | None, options: SimulationOptions) -> Dataset:
    """The dataset of a scan, in a named or in a temporary file."""
    if out is not None:
        check_dataset_name(Path(out))
        return open_dataset(simulate(scan, out, **vars(options)).path)
    folder = mkdtemp(prefix="phantomgen-")
    try:
        dataset = open_dataset(simulate(scan, Path(folder, f"{scan.name}.h5"), **vars(options)).path)
    except BaseException:
        rmtree(folder, ignore_errors=True)
        raise
    return replace(dataset, on_close=weakref.finalize(dataset.file, rmtree, folder, ignore_errors=True))
