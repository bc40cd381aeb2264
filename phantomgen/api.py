"""Short interface for Python: scenes to plans and datasets, scans of others to datasets, datasets to worse ones."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.writing.writer import check_dataset_name
from phantomgen.degradation.run import degrade_file
from phantomgen.degradation.settings import Degradation
from phantomgen.importers.formats import import_scan as write_imported
from phantomgen.scene.scan import Scan, load_scene
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import TOLERANCE, Plan
from phantomgen.simulation.run import simulate


def plan(scan: Scan | str | Path, *, tolerance: float = TOLERANCE) -> Plan:
    """Choose how finely a scan will be computed, and measure the error.

    Parameters
    ----------
    scan : what to simulate, or a preset or scene file
    tolerance : worst error of log projections that is wanted

    Returns
    -------
    the plan
    """
    return make_plan(_scan(scan), tolerance)


def make(
    scan: Scan | str | Path,
    out: Path | str | None = None,
    *,
    seed: int | None = None,
    **options: Any,
) -> Dataset:
    """Simulate a scan and open its dataset.

    Parameters
    ----------
    scan : what to simulate, or a preset or scene file
    out : name of the dataset; ``<name of the scene>.h5`` where left out
    seed : of the noise; that of the scene where left out
    **options : fields of `phantomgen.simulation.options.SimulationOptions`, such as ``tolerance=1e-4`` or
        ``overwrite=True``; `phantomgen.simulation.run.simulate` takes them as well, and returns the time of the
        simulation and the error of its counts

    Returns
    -------
    the dataset, to be closed or used in a ``with`` statement
    """
    scan = _scan(scan)
    if seed is not None:
        scan = replace(scan, seed=seed)
    path = Path(out or f"{scan.name}.h5")
    check_dataset_name(path)
    return open_dataset(simulate(scan, path, **options).path)


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
    settings : what is made worse; `options` where left out
    overwrite : replace a file that exists
    **options : fields of `phantomgen.degradation.settings.Degradation`, such as ``dose=0.25``; they replace those of
        `settings`

    Returns
    -------
    the new dataset, to be closed or used in a ``with`` statement
    """
    path = dataset.path if isinstance(dataset, Dataset) else Path(dataset)
    wanted = replace(settings or Degradation(), **options)
    return open_dataset(degrade_file(path, out, wanted, overwrite=overwrite).path)


def import_scan(
    name: str,
    paths: Path | str | Sequence[Path | str],
    out: Path | str,
    *,
    overwrite: bool = False,
    **options: Any,
) -> Dataset:
    """Write the dataset of a scan of another program or of a scanner, and open it.

    Parameters
    ----------
    name : of the format, one of those of `phantomgen import`, such as ``nikon``
    paths : of the scan; several are channels, where the format has one file per channel
    out : name of the dataset
    overwrite : replace a file that exists
    **options : ``title``; facts that no file states, fields of `phantomgen.importers.scans.stated.Stated` such as
        ``kvp=90``, ``filters="0.5 mm Cu"`` and ``photons=20000``; what is to be written, fields of
        `phantomgen.importers.scans.finish.Wanted` such as ``bin=4``

    Returns
    -------
    the dataset, to be closed or used in a ``with`` statement
    """
    listed = [paths] if isinstance(paths, Path | str) else paths
    done = write_imported(name, [Path(path) for path in listed], Path(out), overwrite=overwrite, **options)
    return open_dataset(done.path)


def _scan(scan: Scan | str | Path) -> Scan:
    return scan if isinstance(scan, Scan) else load_scene(scan)
