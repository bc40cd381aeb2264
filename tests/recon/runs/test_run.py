"""The steps of a run, with a method that does nothing but note when it is asked."""

import json
from unittest.mock import Mock

import numpy as np
import pytest

from phantomgen.dataset.reader import Dataset
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.stopwatch import Stopwatch
from recon.runs.outcomes.iteration_log import IterationLog
from recon.runs.run import run
from recon.voxel.method import Iteration


class Noted:
    """A method and its outcome; every call is noted by name."""

    left_out = ("kedge_I",)

    def __init__(self, folder, fails=False):
        self.calls, self.folder, self.fails = [], folder, fails

    def check(self, dataset):
        self.calls.append("check")

    def reconstruct(self, dataset, folder, clock, watcher):
        assert isinstance(clock, Stopwatch)
        self.calls.append("reconstruct")
        return self

    def write(self, folder):
        self.calls.append("write")

    def scores(self, truth, guard):
        self.calls.append(f"scores with {truth}")
        return {"dataset": "scan.h5"}

    def draw(self, truth, folder, guard):
        self.calls.append("draw")
        assert json.loads((self.folder / "metrics.json").read_text())["dataset"] == "scan.h5"
        with guard("drawing it"):
            if self.fails:
                raise RuntimeError("this one")


@pytest.fixture
def dataset():
    noted = []
    return Mock(spec=Dataset, splits={"test": [3, 7]}, path="scan.h5", load=noted.append, noted=noted)


def test_the_truth_is_read_when_the_result_is_written_and_scores_come_before_figures(dataset, tmp_path, monkeypatch):
    method, watcher = Noted(tmp_path), Mock()
    monkeypatch.setattr("recon.runs.run.read_truth", lambda path: method.calls.append("read") or "truth")
    metrics = run(dataset, tmp_path, method, True, watcher)
    assert method.calls == ["check", "reconstruct", "write", "read", "scores with truth", "draw"]
    assert dataset.noted == [[3], [7]]
    assert json.loads((tmp_path / "metrics.json").read_text()) == metrics
    assert list(metrics["seconds"]) == ["check", "write", "score", "figures"]
    watcher.note.assert_called_once_with("Not fitted, though the file has it: kedge_I")


def test_a_failure_after_the_result_is_written_is_named_in_the_metrics(dataset, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.runs.run.read_truth", Mock(side_effect=RuntimeError("that one")))
    metrics = run(dataset, tmp_path, Noted(tmp_path, fails=True), True, Mock())
    assert metrics["failed"] == {
        "reading the truth": "RuntimeError: that one", "drawing it": "RuntimeError: this one",
    }  # fmt: skip


def test_a_process_without_a_folder_takes_part_and_writes_nothing(dataset, tmp_path):
    method = Noted(tmp_path)
    assert run(dataset, None, method, True, Mock()) == {}
    assert method.calls == ["check", "reconstruct"]
    assert list(tmp_path.iterdir()) == []


def test_a_log_keeps_a_tenth_of_all_volumes_and_adds_their_scores(tmp_path):
    log = IterationLog(tmp_path, Grid.cube(1, 1.0), ("compton",))
    values = np.zeros((1, 1, 1, 1), np.float32)
    for done in range(1, 21):
        values += 1  # a method changes its volumes in place
        log.add(Iteration(done, 20, 0.5, values))
    kept = {done: model.values.item() for done, model in log.models()}
    assert kept == {done: float(done) for done in range(2, 21, 2)}
    log.add_scores({20: {"psnr_compton": 30.0}})
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["iteration"] for line in lines] == list(range(1, 21))
    assert lines[-1]["psnr_compton"] == 30.0
    assert "psnr_compton" not in lines[0]
