"""Batches: items that depend on their number only, made by whoever is there, whatever dies on the way."""

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from hashlib import sha256

import numpy as np
import pytest
from click.testing import CliRunner

from phantomgen.batch import run as batch_module
from phantomgen.batch.executors import process_pool, results
from phantomgen.batch.manifest import Batch
from phantomgen.batch.records import Record, Shard, append_record, read_records
from phantomgen.batch.run import make_item, run_batch
from phantomgen.cli.main import main
from phantomgen.dataset.reader import open_dataset
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 3, test_views: 0}
panel: {rows: 6, columns: 8, pitch: 4}
volume: {voxels: 4, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: {uniform: [3, 6]}}
flats: 1
"""
MANIFEST = """\
version: 1
scene: toy.yaml
set: {geometry.views: 2, panel: {rows: 4, columns: 8, pitch: 4}}
seed: 10
count: 4
"""


@pytest.fixture
def batch(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    (tmp_path / "toy.yaml").write_text(SCENE)
    (tmp_path / "toys.yaml").write_text(MANIFEST)
    return Batch.read(tmp_path / "toys.yaml")


def in_threads(batch, folder, **options):
    with ThreadPoolExecutor(1) as executor:
        return run_batch(batch, folder, executor=executor, **options)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def hashes(folder):
    return {path.name: sha256(path.read_bytes()).hexdigest() for path in folder.glob("*.h5")}


def test_item_i_is_the_scene_of_seed_plus_i(batch, tmp_path):
    summary = in_threads(batch, tmp_path / "out")
    assert (summary.items, summary.made, summary.failed) == (4, 4, ())
    scene = SceneFile.read(tmp_path / "toy.yaml", ["geometry.views=2", "panel.rows=4", "seed=12"])
    simulate(load_scene(scene), tmp_path / "twelve.h5")
    with open_dataset(tmp_path / "twelve.h5") as one, open_dataset(tmp_path / "out" / "item000002.h5") as item:
        assert np.array_equal(one.load(), item.load())
    records = [json.loads(line) for line in (tmp_path / "out" / "manifest.jsonl").read_text().splitlines()]
    assert [(r["id"], r["seed"], r["path"], r["status"]) for r in records] == [
        (i, 10 + i, f"item{i:06d}.h5", "done") for i in range(4)
    ]
    assert {r["path"]: r["sha256"] for r in records} == hashes(tmp_path / "out")


def test_a_second_run_makes_what_is_missing_only(batch, tmp_path, monkeypatch):
    out, made = tmp_path / "out", []
    in_threads(batch, out)
    before = hashes(out)
    monkeypatch.setattr(batch_module, "make_item", lambda item: made.append(item.number) or make_item(item))
    (out / "item000001.h5").unlink()
    assert in_threads(batch, out, count=6).made == 3
    assert sorted(made) == [1, 4, 5]
    assert {name: found for name, found in hashes(out).items() if name in before} == before


def test_parts_of_a_batch_have_records_of_their_own(batch, tmp_path):
    out = tmp_path / "out"
    for part in ("2/3", "1/3"):
        in_threads(batch, out, shard=Shard.parse(part))
    assert names(out) == [
        "item000000.h5",
        "item000001.h5",
        "item000003.h5",
        "manifest.1of3.jsonl",
        "manifest.2of3.jsonl",
    ]
    assert in_threads(batch, out).made == 1
    assert sorted(read_records(out)) == [0, 1, 2, 3]


def test_one_bad_item_is_recorded_and_the_rest_is_made(batch, tmp_path):
    text = SCENE.replace("uniform: [3, 6]", "choice: [5, 5, 5, -1]")
    (tmp_path / "toy.yaml").write_text(text)
    result = CliRunner().invoke(
        main,
        ["batch", str(tmp_path / "toys.yaml"), "-n", "12", "-o", str(tmp_path / "out"), "--workers", "1", "--json"],
    )
    summary = json.loads(result.stdout)
    assert result.exit_code == 3
    assert 0 < len(summary["failed"]) == 12 - summary["made"] < 12
    for record in summary["failed"]:
        assert record["status"] == "failed"
        assert record["message"].endswith("objects.0.radius - input should be greater than 0, got -1")
        assert not (tmp_path / "out" / record["path"]).exists()
    again = in_threads(Batch.read(tmp_path / "toys.yaml"), tmp_path / "out", count=12)
    assert again.made == 0
    assert len(again.failed) == len(summary["failed"])


def test_a_folder_of_another_manifest_is_refused(batch, tmp_path):
    in_threads(batch, tmp_path / "out", count=1)
    (tmp_path / "toys.yaml").write_text(MANIFEST.replace("seed: 10", "seed: 11"))
    other = Batch.read(tmp_path / "toys.yaml")
    with pytest.raises(InputError, match=r"holds items of another manifest than .*toys.yaml is now: choose another"):
        in_threads(other, tmp_path / "out", count=1)
    assert in_threads(other, tmp_path / "out", count=1, overwrite=True).made == 1


def test_a_record_that_was_cut_off_does_no_harm(batch, tmp_path):
    out = tmp_path / "out"
    in_threads(batch, out)
    path = out / "manifest.jsonl"
    path.write_bytes(path.read_bytes()[:-20])
    assert in_threads(batch, out).made == 1
    append_record(path, Record(9, 9, "a", "", "failed", "x", 0.0, ""))
    assert len(read_records(out)) == 5


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("version: 1", "name either a preset or a scene"),
        ("- 1", "a manifest is a mapping of keys"),
        ("a: [", "is no YAML"),
        ("version: 1\npreset: kedge\nn: 3", "n - unknown key: choose from version, preset"),
        ("version: 1\npreset: kegde", "unknown preset 'kegde'; did you mean 'kedge'"),
        ("version: 1\npreset: kedge\ncount: 0", "count - input should be greater than or equal to 1"),
        ("version: 1\npreset: kedge\nset: {objects.0.radius: -1}", "objects.0.radius - input should be greater than 0"),
        ("version: 1\ngeometry: {}\nobjects: []", r"bad.yaml is a scene and no manifest.*`phantomgen make .*bad.yaml`"),
        ("version: 1\nscene: none.yaml", "none.yaml cannot be read as a scene"),
    ],
)
def test_a_bad_manifest_is_one_sentence_before_any_work(text, words, tmp_path):
    (tmp_path / "bad.yaml").write_text(text)
    with pytest.raises((InputError, SceneError), match=words) as caught:
        Batch.read(tmp_path / "bad.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["0/3", "4/3", "1", "a/b", "1/-2"])
def test_a_part_is_written_i_of_n(text):
    with pytest.raises(InputError, match=r"written i/n with 1 <= i <= n"):
        Shard.parse(text)


class Mortal(Executor):
    """An executor that breaks when it is given one of some items."""

    def __init__(self, deadly):
        self.deadly, self.broken = deadly, False

    def submit(self, work, item):
        if self.broken:
            raise BrokenProcessPool("broken")
        future: Future = Future()
        self.broken = item in self.deadly
        if self.broken:
            future.set_exception(BrokenProcessPool("died"))
        else:
            future.set_result(work(item))
        return future


@pytest.mark.parametrize("deadly", [set(), {3}, {0}, {0, 9}, set(range(10))])
@pytest.mark.parametrize("workers", [1, 3])
def test_a_pool_that_breaks_loses_the_culprit_only(deadly, workers):
    found = dict(results(str, range(10), lambda count: Mortal(deadly), workers))
    assert {item for item, result in found.items() if isinstance(result, BrokenProcessPool)} == deadly
    assert {item for item, result in found.items() if result == str(item)} == set(range(10)) - deadly


def test_a_process_that_is_killed_costs_its_own_item_only():
    deadly = "__import__('os').kill(__import__('os').getpid(), 9)"
    found = dict(results(eval, ["0", "1", deadly, "3", "__import__('os').getpid()"], process_pool, 2))
    assert isinstance(found.pop(deadly), BrokenProcessPool)
    assert found.pop("__import__('os').getpid()") != os.getpid()
    assert found == {"0": 0, "1": 1, "3": 3}


def test_workers_end_with_the_process_that_started_them(batch, tmp_path):
    command = [
        sys.executable,
        "-m",
        "phantomgen",
        "batch",
        str(tmp_path / "toys.yaml"),
        "-n",
        "500",
        "--workers",
        "1",
    ]
    process = subprocess.Popen([*command, "-o", str(tmp_path / "out")])
    while not (tmp_path / "out" / "item000001.h5").exists():
        assert process.poll() is None
        time.sleep(0.02)
    process.kill()
    process.wait()
    time.sleep(0.5)
    there = names(tmp_path / "out")
    time.sleep(0.3)
    assert names(tmp_path / "out") == there
    assert in_threads(batch, tmp_path / "out", count=3).made <= 2


@pytest.mark.filterwarnings("default")
@pytest.mark.slow
def test_a_dask_cluster_makes_all_items_though_a_worker_is_killed(batch, tmp_path):
    distributed = pytest.importorskip("distributed")
    out, count = tmp_path / "out", 12
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path / "dask")
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        workers = client.run(os.getpid)
        assert len(workers) == 2

        def append_and_kill(path, record):
            append_record(path, record)
            if len(read_records(out)) == 3:
                os.kill(next(iter(workers.values())), signal.SIGKILL)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(batch_module, "append_record", append_and_kill)
            summary = run_batch(batch, out, count=count, executor=cluster.scheduler_address)
        assert (summary.made, summary.failed) == (count, ())
        assert set(client.run(os.getpid).values()) != set(workers.values())
    in_threads(batch, tmp_path / "here", count=count)
    assert hashes(out) == hashes(tmp_path / "here")


def test_a_scheduler_that_does_not_answer_is_one_sentence(batch, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("phantomgen.batch.executors._PATIENCE", "1s")
    with pytest.raises(InputError, match=r"there is no Dask scheduler at tcp://127.0.0.1:9 \(.*\): start one by"):
        run_batch(batch, tmp_path / "out", executor="tcp://127.0.0.1:9")
