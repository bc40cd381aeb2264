"""Outputs that exist are refused by one function and in one form, whichever command writes them."""

import os
import re
from pathlib import Path

import pytest

from phantomgen.runtime.outputs import check_output, check_output_folder, refuse_interrupted
from spectra.errors import InputError

ROOT = Path(__file__).parents[3]
EXISTS = "the output {} exists: choose another name by --out, or add --overwrite"


def is_own(folder):
    return (folder / "mine").is_file()


def test_only_one_file_of_the_program_says_that_an_output_exists():
    files = [path for package in ("recon", "phantomgen", "spectra") for path in (ROOT / package).rglob("*.py")]
    saying = [path.name for path in files if re.search(r'Error\(\s*f?"the output \{.*exists', path.read_text("utf-8"))]
    assert saying == ["outputs.py"]


@pytest.mark.parametrize("kind", ["file", "dangling link"])
def test_a_file_is_replaced_only_when_that_is_asked_for(kind, tmp_path):
    path = tmp_path / "scan.h5"
    check_output(path, overwrite=False)
    path.write_bytes(b"\x89HDF\r\n\x1a\n old") if kind == "file" else path.symlink_to(tmp_path / "nowhere")
    with pytest.raises(InputError, match=f"^{re.escape(EXISTS.format(path))}$"):
        check_output(path, overwrite=False)
    check_output(path, overwrite=True)


@pytest.mark.parametrize(
    ("name", "words"),
    [("folder", "is a folder: name a file in it, such as .*scan.h5"), ("none/scan.h5", "none for the output scan.h5")],
)
def test_a_file_needs_a_folder_to_be_in(name, words, tmp_path):
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match=words):
        check_output(tmp_path / name, overwrite=True)


def test_a_folder_is_replaced_only_when_the_same_command_wrote_it(tmp_path):
    path = tmp_path / "run"
    check_output_folder(path, False, "recon", is_own)
    path.mkdir()
    with pytest.raises(InputError, match=f"^{re.escape(EXISTS.format(path))}$"):
        check_output_folder(path, False, "recon", is_own)
    with pytest.raises(InputError, match="exists: add --resume to go on, choose another name by --out, or add"):
        check_output_folder(path, False, "recon", is_own, "go on")
    with pytest.raises(InputError, match="is not a folder that recon wrote; it will not be replaced"):
        check_output_folder(path, True, "recon", is_own)
    (path / "mine").write_text("")
    check_output_folder(path, True, "recon", is_own)
    (tmp_path / "link").symlink_to(path)
    with pytest.raises(InputError, match="is not a folder that recon wrote"):
        check_output_folder(tmp_path / "link", True, "recon", is_own)


@pytest.mark.parametrize(("resume", "overwrite"), [(True, False), (False, True)])
def test_what_an_interrupted_run_left_is_taken_up_or_removed_as_asked(resume, overwrite, tmp_path):
    refuse_interrupted(tmp_path, resume, overwrite)
    with pytest.raises(InputError, match="finished: go on by --resume, or anew by --overwrite"):
        refuse_interrupted(tmp_path, False, False)


@pytest.mark.parametrize("name", ["scan.h5", "volume.vti", "page.html", "picture.png", "model.ply"])
def test_only_files_of_the_same_kind_are_replaced(name, tmp_path):
    path = tmp_path / name
    path.write_text("version: 1\n")
    with pytest.raises(InputError, match=r"is not a .* file; it will not be replaced: move it, or choose another name"):
        check_output(path, overwrite=True)
    path.write_text("")
    check_output(path, overwrite=True)


def test_a_function_tells_what_is_of_the_same_kind(tmp_path):
    path = tmp_path / "scan.h5"
    path.write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(InputError, match="is not a dataset; it will not be replaced"):
        check_output(path, overwrite=True, kind=("a dataset", lambda _: False))
    check_output(path, overwrite=True, kind=("a dataset", lambda _: True))


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no such device")
def test_devices_and_pipes_are_not_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe.h5")
    for path in (Path("/dev/full"), tmp_path / "pipe.h5"):
        with pytest.raises(InputError, match="is a device or a pipe and no file; it will not be replaced"):
            check_output(path, overwrite=True)


@pytest.mark.parametrize(
    ("name", "words"),
    [("", "names no file or folder"), ("/", "names no file or folder"), ("x" * 250 + ".h5", r"x \.\.\. x.*253 bytes")],
)
def test_names_that_cannot_be_are_refused(name, words):
    with pytest.raises(InputError, match=words):
        check_output(Path(name), overwrite=True)
    with pytest.raises(InputError, match=words):
        check_output_folder(Path(name), True, "recon", is_own)
