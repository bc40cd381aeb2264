"""Kernels have a place to be kept in, whatever cannot be written."""

import os
import shutil
import subprocess
import sys
import warnings
from pathlib import Path

import pytest

import spectra
from spectra import kernel_cache
from spectra.errors import MachineWarning, StorageError
from spectra.kernel_cache import ensure_kernel_cache, temporary_folder

IMPORTS = """
import os, subprocess, sys
import spectra.ops.transmit
from spectra.ops.transmit.cpu import expected_counts
print(os.environ.get("NUMBA_CACHE_DIR"), expected_counts._cache.cache_path, sep="\\n")
if len(sys.argv) == 1:
    subprocess.run([sys.executable, __file__, "child"], check=True)
"""


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """A folder for temporary files, and nothing chosen for kernels."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    return folder


@pytest.fixture
def operators(tmp_path, monkeypatch):
    """Operators in a package, and a home, where even root writes nothing: a file has the name of the folder."""
    monkeypatch.setenv("HOME", os.devnull)
    folder = tmp_path / "package" / "ops"
    (folder / "trace").mkdir(parents=True)
    for place in (folder.parent, folder, folder / "trace"):
        (place / "__pycache__").touch()
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="the home of another platform is found in other ways")
def test_kernels_are_imported_from_a_package_that_cannot_be_written(temporary, tmp_path):
    source = Path(spectra.__file__).parent
    shutil.copytree(source, tmp_path / "spectra", ignore=shutil.ignore_patterns("__pycache__"))
    for folder in [p for p in (tmp_path / "spectra").rglob("*") if p.is_dir()]:
        (folder / "__pycache__").touch()
    script = tmp_path / "imports.py"
    script.write_text(IMPORTS)
    environment = {**os.environ, "HOME": os.devnull, "PYTHONPATH": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"}
    found = subprocess.run([sys.executable, script], env=environment, capture_output=True, text=True, check=False)
    assert found.returncode == 0, found.stderr
    named, kept, *child = found.stdout.splitlines()
    assert Path(named).parent == temporary
    assert Path(kept).is_relative_to(named)
    assert child == [named, kept]
    assert found.stderr.count("NUMBA_CACHE_DIR") == 1


def test_the_folder_is_the_user_s_alone_and_the_same_in_every_run(temporary):
    first = temporary_folder()
    assert temporary_folder() == first
    assert first.parent == temporary
    if hasattr(os, "getuid"):
        assert first.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="no users to tell apart")
@pytest.mark.parametrize("plant", ["open to others", "a link", "a file", "of somebody else"])
def test_a_folder_that_somebody_could_have_planted_is_not_used(plant, temporary, tmp_path):
    planted = temporary / f"spectral-ct-kernels-{os.getuid()}"
    if plant == "a link":
        (tmp_path / "elsewhere").mkdir(mode=0o700)
        planted.symlink_to(tmp_path / "elsewhere")
    elif plant == "a file":
        planted.touch(mode=0o700)
    else:
        planted.mkdir(mode=0o700)
        if plant == "open to others":
            planted.chmod(0o777)
        elif os.getuid() == 0:
            os.chown(planted, 65534, 65534)
        else:
            pytest.skip("only root makes folders of other users")
    found = temporary_folder()
    assert found != planted
    assert found.stat().st_mode & 0o777 == 0o700


def test_a_folder_that_was_chosen_and_can_be_written_is_used(temporary, operators, tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "mine"))
    ensure_kernel_cache(operators)
    assert os.environ["NUMBA_CACHE_DIR"] == str(tmp_path / "mine")
    assert list(temporary.iterdir()) == []


def test_a_folder_that_was_chosen_and_cannot_be_written_is_named(temporary, operators, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "/dev/null/mine")
    with pytest.warns(MachineWarning, match="NUMBA_CACHE_DIR=/dev/null/mine"):
        ensure_kernel_cache(operators)
    assert Path(os.environ["NUMBA_CACHE_DIR"]).parent == temporary


@pytest.mark.parametrize("place", ["code", "home"])
def test_nothing_happens_where_numba_finds_a_place(place, temporary, operators, tmp_path, monkeypatch):
    if place == "home":
        monkeypatch.setenv("HOME", str(tmp_path / "home"))
    else:
        for file in operators.parent.rglob("__pycache__"):
            file.unlink()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ensure_kernel_cache(operators)
    assert "NUMBA_CACHE_DIR" not in os.environ
    assert list(temporary.iterdir()) == []


def test_without_any_place_there_is_one_sentence(operators, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def nowhere():
        raise OSError("read-only")

    monkeypatch.setattr(kernel_cache, "temporary_folder", nowhere)
    with pytest.raises(StorageError, match="set NUMBA_CACHE_DIR to one that can"):
        ensure_kernel_cache(operators)
