"""An output has one writer; what a process that was killed left does not stop the next one."""

import json
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from phantomgen.runtime.disk import complete_file
from phantomgen.runtime.output_lock import output_lock, refuse_locked
from spectra.errors import InputError

MAKE = "from phantomgen.cli.main import main; main(prog_name='phantomgen')"


def lock_of(path, **owner):
    path.with_name(path.name + ".lock").write_text(json.dumps(owner))


def test_a_second_writer_is_told_who_the_first_is(tmp_path):
    path = tmp_path / "out.h5"
    with output_lock(path):
        with pytest.raises(InputError, match=f"out.h5 is being written by process {os.getpid()}: wait"):
            refuse_locked(path)
        with pytest.raises(InputError, match="is being written by process"), complete_file(path, ".h5"):
            pass
    refuse_locked(path)
    assert list(tmp_path.iterdir()) == []


def test_a_process_of_another_computer_is_named(tmp_path):
    path = tmp_path / "out.h5"
    lock_of(path, pid=1, host="elsewhere")
    with (
        pytest.raises(InputError, match=r"by process 1 on elsewhere: wait, .*, or remove out.h5.lock if"),
        output_lock(path),
    ):
        pass


@pytest.mark.parametrize("torn", [False, True])
def test_what_a_killed_process_left_is_taken_over(torn, tmp_path):
    path = tmp_path / "out.h5"
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    lock_of(path, pid=ended.pid, host=socket.gethostname())
    if torn:
        path.with_name("out.h5.lock").write_text('{"pid"')
    with output_lock(path):
        pass
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(os.name == "nt", reason="signals mean something else there")
@pytest.mark.slow
def test_make_ends_with_a_sentence_when_it_is_terminated(tmp_path):
    out = tmp_path / "scan.h5"
    words = ["make", "kedge-small", "-o", str(out), "-q", "--views", "20000", "--threads", "1"]
    process = subprocess.Popen([sys.executable, "-W", "ignore", "-c", MAKE, *words], stderr=subprocess.PIPE, text=True)
    journal = tmp_path / "scan.h5.frames"
    end = time.monotonic() + 120
    while not (journal.exists() and journal.stat().st_size > 100_000) and time.monotonic() < end:
        time.sleep(0.1)
    other = subprocess.run(
        [sys.executable, "-c", MAKE, *words, "--resume"], capture_output=True, text=True, check=False
    )
    assert f"scan.h5.frames is being written by process {process.pid}" in other.stderr
    process.send_signal(signal.SIGTERM)
    said = process.communicate(timeout=60)[1]
    assert process.returncode == 143
    assert "Ended by SIGTERM; " in said
    assert "are kept in" in said
    assert "Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == ["scan.h5.frames"]
