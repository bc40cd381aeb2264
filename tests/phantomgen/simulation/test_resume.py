"""Interrupted runs: killed, cut off, out of disk; what goes on from them is the file that would have been."""

import os
import random
import signal
import subprocess
import sys
import time
import warnings
from types import SimpleNamespace

import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main
from phantomgen.dataset.writing import frame_journal
from phantomgen.dataset.writing.frame_journal import FrameJournal, journal_path
from phantomgen.runtime import disk as disk_room
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, StorageError
from spectra.threads import set_threads

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20, 50]}
geometry: {type: circular, sod: 100, sdd: 200, views: 20, test_views: 5}
panel: {rows: 24, columns: 24, pitch: 1}
volume: {voxels: 8, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 5}
flats: 4
"""


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


@pytest.fixture(scope="module", autouse=True)
def fixed_date():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SOURCE_DATE_EPOCH", "0")
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Bytes of an uninterrupted run."""
    path = tmp_path_factory.mktemp("whole") / "a.h5"
    simulate(toy(), path, keep_expected=True)
    return path.read_bytes()


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """Bytes of the journal when all frames are there and the dataset is not."""
    path = tmp_path_factory.mktemp("journal") / "a.h5"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("phantomgen.simulation.run.write_frames", interrupt)
        with pytest.raises(KeyboardInterrupt, match=r"25 views and 4 flats are kept in .*: go on by --resume$"):
            simulate(toy(), path, keep_expected=True)
    assert [child.name for child in path.parent.iterdir()] == ["a.h5.frames"]
    return journal_path(path).read_bytes()


def interrupt(*_):
    raise KeyboardInterrupt


def resumed(path):
    simulate(toy(), path, keep_expected=True, resume=True)
    assert [child.name for child in path.parent.iterdir()] == [path.name]
    return path.read_bytes()


@pytest.mark.parametrize("part", [0.0, 0.001, 0.01, 0.3, 0.5, 0.7, 0.99, 0.9999, 1.0])
def test_a_journal_cut_off_anywhere_leads_to_the_same_bytes(part, whole, journal, tmp_path):
    path = tmp_path / "a.h5"
    journal_path(path).write_bytes(journal[: int(part * len(journal))])
    assert resumed(path) == whole


def test_a_frame_that_changed_on_disk_is_computed_again(whole, journal, tmp_path, monkeypatch):
    path, computed = tmp_path / "a.h5", []
    broken = bytearray(journal)
    broken[len(journal) // 2] ^= 1
    journal_path(path).write_bytes(bytes(broken))
    expected = Views.expected
    monkeypatch.setattr(Views, "expected", lambda *a: computed.append(a[1]) or expected(*a))
    assert resumed(path) == whole
    assert 8 <= len(computed) <= 20


def test_what_lies_beside_a_journal_does_not_matter(whole, journal, tmp_path):
    path = tmp_path / "a.h5"
    journal_path(path).write_bytes(journal)
    (tmp_path / "a.h5.part").write_bytes(b"left by a process that was killed while it wrote the dataset")
    assert resumed(path) == whole


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_again_and_again_at_any_moment_it_ends_as_if_nothing_had_been(tmp_path):
    set_threads(1)
    options = ("geometry.views=60",)
    simulate(toy(*options), tmp_path / "whole.h5")
    path, moments, kills = tmp_path / "a" / "a.h5", random.Random(1), 0
    path.parent.mkdir()
    begun = time.monotonic()
    while not path.exists() and kills < 60:
        child = forked(lambda: simulate(toy(*options), path, resume=True))
        time.sleep(moments.uniform(0, 0.1 + 0.04 * kills))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        kills += 1
    set_threads(None)
    print(f"{kills} kills in {time.monotonic() - begun:.1f} s")  # noqa: T201 - shown when it fails
    simulate(toy(*options), path, resume=True, overwrite=True)
    assert path.read_bytes() == (tmp_path / "whole.h5").read_bytes()


def forked(task):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # threads of other tests wait for work, and no child asks them for it
        child = os.fork()
    if child == 0:
        task()
        os._exit(0)
    return child


def _heed_interrupts():
    """Shells make what they start in the background ignore them."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_the_command_survives_a_kill_and_an_interrupt(tmp_path):
    (tmp_path / "toy.yaml").write_text(SCENE.replace("views: 20", "views: 2000"))
    path, journal = tmp_path / "toy.h5", tmp_path / "toy.h5.frames"
    command = [sys.executable, "-m", "phantomgen", "make", "toy.yaml"]
    sizes = []
    for end, options in ((signal.SIGKILL, []), (signal.SIGINT, ["--resume"])):
        process = subprocess.Popen(
            [*command, *options],
            cwd=tmp_path,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=_heed_interrupts,  # noqa: PLW1509 - the child sets one signal, no more
        )
        while not journal.exists() or journal.stat().st_size < 4e4 + sum(sizes):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(end)
        message = process.communicate()[1]
        sizes.append(journal.stat().st_size)
        assert not path.exists()
    assert process.returncode == 130
    assert "views are kept in toy.h5.frames: go on by --resume." in message
    again = CliRunner().invoke(main, ["make", str(tmp_path / "toy.yaml"), "-o", str(path)])
    assert again.exit_code == 1
    assert again.stderr == (
        f"Error: {journal} holds what an interrupted run finished: go on by --resume, or anew by --overwrite\n"
    )


@pytest.mark.parametrize(
    ("overrides", "options", "words"),
    [
        (("seed=1",), {}, "another scene:"),
        (("source.energy=61",), {}, "another energies and scene:"),
        (("objects.0.radius=6",), {}, "another (energies and )?objects and scene( and settings)?:"),
        ((), {"keep_expected": False}, "another keep:"),
        ((), {"compression": "none"}, "another compression:"),
    ],
)
def test_another_scan_is_not_resumed_but_may_replace_it(overrides, options, words, journal, tmp_path):
    path = tmp_path / "a.h5"
    journal_path(path).write_bytes(journal)
    options = {"keep_expected": True, **options}
    with pytest.raises(InputError, match=f"cannot be resumed, as it was begun with {words}"):
        simulate(toy(*overrides), path, resume=True, **options)
    assert journal_path(path).read_bytes() == journal
    simulate(toy(*overrides), path, resume=True, overwrite=True, **options)
    simulate(toy(*overrides), tmp_path / "b.h5", **options)
    assert path.read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_a_journal_has_one_writer(tmp_path):
    pytest.importorskip("fcntl")
    with FrameJournal(tmp_path / "a.h5", {}) as first:
        first.append("views", 0, {"data": [[b"1"]]})
        with (
            pytest.raises(InputError, match="is being written by"),
            FrameJournal(tmp_path / "a.h5", {}, resume=True),
        ):
            pass


def test_an_error_that_would_come_again_leaves_nothing(tmp_path, monkeypatch):
    def fail(self, expected, frame, *stream):
        if frame == 3:
            raise InputError("too many photons")
        return measured(self, expected, frame, *stream)

    measured = Views.registered
    monkeypatch.setattr(Views, "registered", fail)
    with pytest.raises(InputError, match="too many photons"):
        simulate(toy(), tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_what_cannot_fit_is_refused_after_one_frame(tmp_path, monkeypatch):
    monkeypatch.setattr(
        disk_room.shutil,
        "disk_usage",
        lambda _: SimpleNamespace(free=12_300),
    )
    with pytest.raises(InputError, match=r"a.h5.frames needs about \d+\.\d kB of disk while .* 12.3 kB are free"):
        simulate(toy(), tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("room", [0.0, 0.5, 0.99, 1.2, 1.9])
def test_a_full_disk_is_one_sentence_and_the_run_goes_on_when_there_is_room(room, whole, journal, tmp_path):
    """On a real file system that is too small."""
    small = tmp_path / "small"
    small.mkdir()
    size = int(room * len(journal)) // 4096 * 4096 + 4096
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", small], capture_output=True, check=False
    )
    if mounted.returncode:
        pytest.skip("this user may not mount file systems")
    path = small / "a.h5"
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("phantomgen.simulation.write_frames.check_free_space", lambda *_: None)
            with pytest.raises(
                StorageError, match=r"cannot be written: the disk is full, .* free.*: make room"
            ) as caught:
                simulate(toy(), path, keep_expected=True)
        assert "\n" not in str(caught.value)
        assert {child.name for child in small.iterdir()} <= {"a.h5.frames"}
        subprocess.run(["mount", "-o", f"remount,size={8 * len(whole)}", small], check=True)
        assert resumed(path) == whole
    finally:
        subprocess.run(["umount", small], check=True)


def test_a_write_that_fails_leaves_whole_frames_only(tmp_path):
    def write():
        with FrameJournal(tmp_path / "a.h5", {}) as journal:
            journal.append("views", 0, {"data": [[b"12345"]]})
            journal._file = HalfFull(journal._file)
            journal.append("views", 1, {"data": [[b"x" * 1000]]}, 3000)

    with pytest.raises(StorageError, match=r"the disk is full, .* free and about 3\.0 kB more are needed: make room"):
        write()
    with FrameJournal(tmp_path / "a.h5", {}, resume=True) as journal:
        assert list(journal.frames()) == [("views", 0, {"data": [[b"12345"]]})]
        assert (tmp_path / "a.h5.frames").read_bytes().endswith(b"12345")


class HalfFull:
    """A file that takes 100 bytes more."""

    def __init__(self, file):
        self.file, self.left = file, 100

    def __getattr__(self, name):
        return getattr(self.file, name)

    def write(self, data):
        if not self.left:
            raise OSError(28, "No space left on device")
        data, self.left = data[: self.left], 0
        return self.file.write(data)


def test_a_folder_that_is_not_writable_is_one_sentence(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write everywhere
    with pytest.raises(InputError, match=r"the folder .* for the output a.h5 is not writable: choose another"):
        simulate(toy(), tmp_path / "a.h5")


def test_every_record_has_a_checksum(tmp_path):
    path = tmp_path / "a.h5"
    frame = {"data": [[b"one", b"two"], [b"three"]], "expected": [[b""]]}
    with FrameJournal(path, {"scene": "x"}) as journal:
        journal.append("views", 0, frame)
        assert list(journal.frames()) == [("views", 0, frame)]
        data = journal.path.read_bytes()
    assert list(tmp_path.iterdir()) == []
    for i in range(len(data)):
        changed = bytearray(data)
        changed[i] ^= 0x20
        journal_path(path).write_bytes(bytes(changed))
        with journal_path(path).open("rb") as reader:
            assert len(list(frame_journal._records(reader))) < 2
