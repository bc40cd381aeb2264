"""Many scans from one manifest: one dataset each, and a record of what became of it.

A run does what is missing. Items are independent of each other and of the order in which they are made, and so of the
workers that make them: processes of this machine, a Dask cluster, or any executor of `concurrent.futures`.
"""

import time
from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from hashlib import file_digest
from pathlib import Path
from typing import Any

from phantomgen.batch.executors import dask_pool, own_executor, process_pool, results, sentence
from phantomgen.batch.manifest import Batch, Item
from phantomgen.batch.records import DONE, FAILED, Record, Shard, append_record, read_records, rewrite_records
from phantomgen.runtime.disk import one_sentence
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import InputError
from spectra.threads import available_threads, set_threads


@dataclass(frozen=True)
class BatchSummary:
    """Summary of a run of a batch.

    Parameters
    ----------
    folder : of the datasets
    items : number of requested items
    made : how many this run made
    failed : records of those that failed
    seconds : wall time
    """

    folder: Path
    items: int
    made: int
    failed: tuple[Record, ...]
    seconds: float

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        failed = [asdict(record) for record in self.failed]
        return {**vars(self), "folder": str(self.folder), "failed": failed}

    @property
    def text(self) -> str:
        """Summary as text."""
        done = self.items - len(self.failed)
        lines = [f"{self.folder}: {done} of {self.items} items are there, {self.made} made in {self.seconds:.1f} s"]
        return "\n".join([*lines, *(f"failed   item {r.id}, seed {r.seed}: {r.message}" for r in self.failed)])


def run_batch(
    batch: Batch,
    folder: Path | str,
    *,
    count: int | None = None,
    workers: int | None = None,
    executor: Executor | str | None = None,
    shard: Shard | None = None,
    overwrite: bool = False,
    progress: bool = False,
) -> BatchSummary:
    """Make the items of a batch that are missing or failed.

    Parameters
    ----------
    batch : what to make
    folder : of the datasets and their records; it is made where it is missing
    count : number of items, in place of the manifest's
    workers : processes of this machine; by default one for each processor
    executor : any executor, or the address of a Dask scheduler, in place of processes of this machine
    shard : the part of the items that this run makes
    overwrite : make all items anew
    progress : show a progress bar on stderr

    Returns
    -------
    the summary

    Raises
    ------
    InputError
        When the folder holds items of another manifest, or cannot be written.
    """
    folder, shard, begun = Path(folder), shard or Shard(), time.perf_counter()
    numbers = shard.numbers(count or batch.model.count)
    with one_sentence(folder):
        folder.mkdir(parents=True, exist_ok=True)
    known = {} if overwrite else _known(batch, folder)
    missing = [batch.item(number, folder) for number in numbers if not _is_there(known.get(number), folder)]
    made, path = {}, folder / shard.records
    try:
        for record in _made(batch, missing, executor, workers or available_threads(), progress):
            append_record(path, record)
            made[record.id] = record
    except KeyboardInterrupt:
        left = len(missing) - len(made)
        raise KeyboardInterrupt(f"{left} of {len(numbers)} items are left: the same command goes on") from None
    final = {**known, **made}
    if made:
        rewrite_records(path, [final[number] for number in numbers])
    failed = tuple(final[number] for number in numbers if final[number].status == FAILED)
    return BatchSummary(folder, len(numbers), len(made) - len(failed), failed, time.perf_counter() - begun)


def make_item(item: Item) -> Record:
    """Make one item; frames of an interrupted run are used.

    Parameters
    ----------
    item : the item

    Returns
    -------
    its record
    """
    set_threads(1)
    begun = time.perf_counter()
    simulate(
        load_scene(item.file),
        item.path,
        overwrite=True,
        resume=True,
        keep_expected=item.keep_expected,
        compression=item.compression,
    )
    with item.path.open("rb") as file:
        digest = file_digest(file, "sha256").hexdigest()
    return Record(item.number, item.seed, item.path.name, digest, DONE, "", time.perf_counter() - begun, "")


def _made(
    batch: Batch, missing: list[Item], executor: Executor | str | None, workers: int, progress: bool
) -> Iterator[Record]:
    """Records of items as they are finished."""
    from tqdm import tqdm  # noqa: PLC0415

    ahead: int | None = 2
    pool = process_pool
    if executor is not None:
        pool, ahead = (dask_pool(executor) if isinstance(executor, str) else own_executor(executor)), None
    found = results(make_item, missing, pool, min(workers, max(1, len(missing))), ahead)
    bar = tqdm(found, total=len(missing), unit="item", leave=False, disable=None if progress else True)
    for item, result in bar:
        if isinstance(result, Record):
            yield replace(result, recipe=batch.recipe)
        else:
            yield Record(item.number, item.seed, item.path.name, "", FAILED, sentence(result), 0.0, batch.recipe)


def _known(batch: Batch, folder: Path) -> dict[int, Record]:
    """Records of earlier runs."""
    known = read_records(folder)
    if any(record.recipe != batch.recipe for record in known.values()):
        raise InputError(
            f"{folder} holds items of another manifest than {batch.name} is now: choose another folder by --out, or "
            "make all items anew by --overwrite"
        )
    return known


def _is_there(record: Record | None, folder: Path) -> bool:
    """Return whether an item requires no work."""
    return record is not None and record.status == DONE and (folder / record.path).is_file()
