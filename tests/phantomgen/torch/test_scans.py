"""Data sets of several scans: what an item is, and that workers change nothing."""

import multiprocessing
import pickle

import numpy as np
import pytest
import torch
from torch.utils.data import DataLoader

import phantomgen
import phantomgen.torch as pt
from spectra.errors import DatasetError, InputError
from spectra.threads import run_parallel, set_threads


def test_views_of_all_files_follow_one_another(scan_paths):
    views = pt.ScanSet(scan_paths).views()
    assert repr(views) == "ScanViews(2 scans, 7 views)"
    assert [(item["scan"], item["view"]) for item in views] == [(0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2)]
    with phantomgen.open(scan_paths[1]) as dataset:
        for item in (views[5], views[-2]):
            np.testing.assert_array_equal(item["counts"], dataset.counts[1])
            np.testing.assert_array_equal(item["line_integrals"], dataset.line_integrals(1))
    with pytest.raises(IndexError, match="there is no view 7"):
        views[7]


def test_a_scan_is_an_item_with_its_truth(scan_paths):
    scans = pt.ScanSet(scan_paths, split="all")
    item = scans[1]
    truth = phantomgen.read_truth(scan_paths[1])
    with phantomgen.open(scan_paths[1]) as dataset:
        np.testing.assert_array_equal(item["counts"], dataset.counts)
        np.testing.assert_array_equal(item["line_integrals"][3], dataset.line_integrals(3))
    np.testing.assert_array_equal(item["truth"], truth.volumes)
    assert (len(scans), item["scan"], scans[-1]["scan"]) == (2, 1, 1)


def batches(views, workers: int, context: str | None = None) -> list[dict]:
    """One epoch in shuffled order, from a seed."""
    order = torch.Generator().manual_seed(5)
    loader = DataLoader(
        views,
        2,
        shuffle=True,
        num_workers=workers,
        generator=order,
        multiprocessing_context=context,
        timeout=120 * (workers > 0),
    )
    return list(loader)


@pytest.mark.parametrize(("workers", "context"), [(1, "fork"), (2, "fork"), (2, "spawn")])
def test_batches_do_not_depend_on_workers(scan_paths, workers, context):
    views = pt.ScanViews(scan_paths)
    alone = batches(views, 0)  # leaves files open in this process, which workers must not use
    assert sorted(zip(*(torch.cat([b[name] for b in alone]).tolist() for name in ("scan", "view")), strict=True)) == [
        (0, 0), (0, 1), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2)
    ]  # fmt: skip
    for one, other in zip(alone, batches(views, workers, context), strict=True):
        for name, value in one.items():
            torch.testing.assert_close(other[name], value, rtol=0, atol=0)


def test_a_process_keeps_few_files_open(scan_paths, monkeypatch):
    monkeypatch.setattr("phantomgen.torch.scans._MOST_OPEN", 1)
    views = pt.ScanViews(scan_paths)
    first = views[0]["counts"]
    views[4]
    assert [one._opened is None for one in views.sets] == [True, False]
    torch.testing.assert_close(views[0]["counts"], first)
    again = pickle.loads(pickle.dumps(views))
    assert all(one._opened is None for one in again.sets)
    torch.testing.assert_close(again[0]["counts"], first)


def test_files_and_splits_that_are_not_there_are_refused(scan_paths, tmp_path):
    with pytest.raises(InputError, match="one file at least"):
        pt.ScanSet([])
    with pytest.raises(InputError, match="paths must be a list of files"):
        pt.ScanSet(str(scan_paths[0]))
    with pytest.raises(InputError, match="no split 'tests'"):
        pt.ScanViews(scan_paths, "tests")
    with pytest.raises(DatasetError, match="there is no dataset"):
        pt.ScanViews([*scan_paths, tmp_path / "none.h5"])


def _squares(sender) -> None:
    sender.send(list(run_parallel(lambda i: i * i, range(5))))


def test_a_forked_process_makes_threads_of_its_own():
    set_threads(2)
    try:
        assert list(run_parallel(lambda i: i + 1, range(3))) == [1, 2, 3]
        receiver, sender = multiprocessing.Pipe(duplex=False)
        process = multiprocessing.get_context("fork").Process(target=_squares, args=(sender,))
        process.start()
        found = receiver.recv() if receiver.poll(30) else "it waits for threads that do not exist"
        process.kill()
        process.join()
        assert found == [0, 1, 4, 9, 16]
    finally:
        set_threads(None)
