"""Volumes and commands of other programs in a comparison: how they are stated, and how a budget is kept."""

import sys
import time

import pytest

from recon.comparison.contenders.other_program import (
    OtherProgram,
    check_names,
    command_program,
    end_commands,
    finished_volume,
    run_command,
)
from recon.comparison.job import Job
from spectra.errors import InputError


def program(code: str) -> OtherProgram:
    """A command in Python; its arguments are the dataset and the output."""
    return OtherProgram(
        "mine", {}, None, (sys.executable, "-S", "-c", code, "{dataset}", "{out}", "{budget}", "{threads}")
    )


WRITE = "import sys; open(sys.argv[2], 'w').write(' '.join(sys.argv[3:]))"


def run(code, folder, budget=30.0, clock="wall", threads=2):
    return run_command(program(code), folder / "scan.h5", folder / "volume.npy", budget, clock, threads)


def test_what_is_stated_is_read():
    found = finished_volume("tigre='my folder/fdk.npy' as=mono:60 units=1/cm axes=zyx same-grid")
    assert found.path == "my folder/fdk.npy"
    assert found.statement == {"as": "mono:60", "units": "1/cm", "axes": "zyx", "same-grid": "yes"}
    found = command_program("mine as=mono:60 suffix=nii.gz: python 'my file.py' --in={dataset} -o {out} -t {budget}")
    assert found.command == ("python", "my file.py", "--in={dataset}", "-o", "{out}", "-t", "{budget}")
    assert (found.suffix, found.statement, found.each_budget) == (".nii.gz", {"as": "mono:60"}, True)
    job = Job("a.h5", "b", "mine", (1.0,), "wall", None, None, ("mono:60",), found)
    assert Job.from_json(job.to_json()) == job


@pytest.mark.parametrize(
    ("read", "text", "words"),
    [
        (finished_volume, "tigre", "--with takes 'NAME=PATH as=mono:60 units=1/mm', got 'tigre'"),
        (finished_volume, "", "--with takes"),
        (finished_volume, "a='b", "No closing quotation"),
        (finished_volume, "fdk=a.npy", "fdk is the name of a method: choose another"),
        (finished_volume, "../a=b.npy", "a name has letters, digits, dots and dashes, got '../a'"),
        (finished_volume, "a=b.npy unit=1/mm", "'unit=1/mm' states nothing about a volume: choose from as=..., units="),
        (finished_volume, "a=b.npy units", "'units' states nothing about a volume"),
        (command_program, "mine", "--run takes 'NAME as=mono:60 units=1/mm: command {dataset} {out}', got 'mine'"),
        (command_program, "mine: python {dataset}", "--run takes"),
        (command_program, ": python {dataset} {out}", "--run takes"),
    ],
)
def test_statements_that_mean_nothing_are_one_sentence(read, text, words):
    with pytest.raises(InputError) as caught:
        read(text)
    assert words in str(caught.value)


def test_names_occur_once():
    with pytest.raises(InputError, match="a occurs twice"):
        check_names([OtherProgram("a"), OtherProgram("b"), OtherProgram("a")])


def test_a_command_gets_its_places_and_is_measured(tmp_path):
    ended = run(f"x = bytearray(64 << 20); {WRITE}", tmp_path)
    assert (tmp_path / "volume.npy").read_text() == "30 2"
    assert ended.error == ""
    assert 0 < ended.seconds < 30
    if sys.platform != "win32":
        assert ended.memory is not None
        assert 64 < ended.memory < 130  # a small process and 64 MiB; not the memory of this one


def test_processor_time_counts_work_and_not_waiting(tmp_path):
    pytest.importorskip("resource")
    ended = run(f"import time; time.sleep(0.6); {WRITE}", tmp_path, budget=0.5, clock="cpu")
    assert ended.error == ""
    assert ended.seconds < 0.5
    ended = run(f"import time\nwhile time.process_time() < 0.6: pass\n{WRITE}", tmp_path, budget=0.5, clock="cpu")
    assert ended.too_short


@pytest.mark.skipif(sys.platform == "win32", reason="process groups")
def test_a_command_that_lasts_is_ended_with_all_it_started(tmp_path):
    child = f"import time, sys; time.sleep(4); open({str(tmp_path / 'late')!r}, 'w')"
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-S', '-c', {child!r}])"
    began = time.perf_counter()
    ended = run(code, tmp_path, budget=0.2)
    assert (ended.too_short, ended.error) == (True, "nothing is ready within 0.2 s: the command did not end")
    time.sleep(max(4.5 - (time.perf_counter() - began), 0))
    assert not (tmp_path / "late").exists()
    end_commands()  # there are none left


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import sys; sys.stderr.write('no\\nsuch kernel\\n'); sys.exit(4)", "ended with status 4: such kernel"),
        ("import sys; sys.exit(1)", "ended with status 1: no message"),
        ("pass", "ended without writing volume.npy"),
    ],
)
def test_a_command_that_fails_says_why(tmp_path, code, words):
    (tmp_path / "volume.npy").write_text("of an earlier run")
    ended = run(code, tmp_path)
    assert words in ended.error
    assert not (tmp_path / "volume.npy").exists()


def test_a_command_that_does_not_exist(tmp_path):
    missing = OtherProgram("mine", {}, None, ("no-such-program", "{dataset}", "{out}"))
    ended = run_command(missing, tmp_path / "a.h5", tmp_path / "volume.npy", 5.0, "wall", None)
    assert ended.error == "the command cannot be run: No such file or directory: no-such-program"
