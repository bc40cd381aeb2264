"""A full disk is one sentence and exit code 1; nothing half-written is left.

A limit on the size of files stands in for the disk: what would be longer is refused in the same way.
"""

import subprocess
import sys

import h5py
import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from recon.cli.main import main as recon
from spectra.errors import StorageError

resource = pytest.importorskip("resource")
LIMITED = """
import resource, runpy, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
limit = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
sys.argv = sys.argv[2:]
runpy.run_module(sys.argv[0], run_name="__main__")
"""
LEAST = 2000  # bytes


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole")
    scan = make(folder / "scan.h5", "--views", "8")
    options = ["-o", str(folder / "run"), "--sweeps", "1", "--no-figures", "--quiet"]
    result = CliRunner().invoke(recon, ["fit", str(scan), *options])
    assert result.exit_code == 0, result.output
    return folder


def limited(limit, *words):
    command = [sys.executable, "-W", "ignore", "-c", LIMITED, str(limit), *map(str, words)]
    return subprocess.run(command, capture_output=True, encoding="utf-8", check=False, timeout=300)


@pytest.mark.parametrize(
    "words",
    [
        ("recon", "volume", "{run}", "-o", "{out}/volume.h5", "-q"),
        ("recon", "volume", "{run}", "-o", "{out}/volume.vti", "-q"),
        ("recon", "volume", "{run}", "-o", "{out}/volume.nii", "-q"),
        ("recon", "render", "{run}", "--like", "{scan}", "-o", "{out}/views.h5", "-q"),
        ("recon", "segment", "{run}", "-o", "{out}/segment", "-q"),
        ("recon", "fit", "{scan}", "-o", "{out}/run", "-q", "--sweeps", "1", "--no-figures"),
        ("phantomgen", "degrade", "{scan}", "-o", "{out}/worse.h5", "--dose", "0.5"),
        ("phantomgen", "spectrum", "kedge-small", "--plot", "{out}/spectrum.png"),
    ],
    ids=lambda words: " ".join(words[:2]),
)
@pytest.mark.slow
def test_a_full_disk_is_one_sentence(words, whole, tmp_path):
    run = [word.format(run=whole / "run", scan=whole / "scan.h5", out=tmp_path) for word in words]
    result = limited(LEAST, *run)
    assert result.returncode == 1, result.stderr
    last = result.stderr.strip().splitlines()[-1]
    assert last.startswith("Error: ")
    assert "cannot be written" in last
    assert "Traceback" not in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_finished_fit_is_not_lost(whole, tmp_path, monkeypatch):
    out = tmp_path / "run"
    words = ["fit", str(whole / "scan.h5"), "-o", str(out), "-q", "--sweeps", "1", "--no-figures"]

    def full(*_args, **_options):
        raise StorageError("volumes.h5 cannot be written: the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr("recon.runs.outcomes.volume_outcome.write_volumes", full)
        sentence = one_sentence(CliRunner().invoke(recon, words))
    assert "the disk is full; what was fitted is kept in" in sentence
    assert sentence.endswith("run.part: go on by --resume\n")
    assert not out.exists()
    result = CliRunner().invoke(recon, [*words, "--resume"])
    assert result.exit_code == 0, result.output
    with h5py.File(out / "volumes.h5") as file:
        assert file["basis/data"].shape[1:] == (16, 16, 16)


def test_a_model_has_the_rights_of_other_files(whole):
    rights = {path.stat().st_mode & 0o777 for path in (whole / "run").iterdir() if path.is_file()}
    assert len(rights) == 1
