"""What commands of `recon` say where a run folder is wanted and something else is given."""

import h5py
import pytest
from click.testing import CliRunner

from recon.cli.main import main

COMMANDS = {
    "view": ["--screenshot", "x.png"],
    "volume": [],
    "render": ["--like", "scan.h5"],
    "export": ["-o", "x.vti"],
    "segment": [],
    "report": [],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    h5py.File("scan.h5", "w").close()
    (tmp_path / "some-run").mkdir()
    h5py.File("some-run/volumes.h5", "w").close()
    return tmp_path


def refusal(*arguments: str) -> str:
    result = CliRunner().invoke(main, arguments)
    assert (result.exit_code, result.stdout, result.stderr.count("\n")) == (1, "", 1)
    return result.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_a_dataset_is_told_from_a_run_folder(name, folder):
    said = refusal(name, "scan.h5", *COMMANDS[name])
    assert "scan.h5 is a dataset and no run folder: `recon fit scan.h5` makes one" in said
    assert "`phantomgen view scan.h5`" in said
    assert "name the folder, some-run" in refusal(name, "some-run/volumes.h5", *COMMANDS[name])
    assert "there is no run folder none" in refusal(name, "none", *COMMANDS[name])


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["fit", "scan.h5", "-o", "result.h5"], "--out names a folder, got result.h5: write result"),
        (["render", "some-run", "-o", "x.nii", "--like", "scan.h5"], "the output x.nii is an HDF5 file"),
        (["render", "some-run", "--like", "scan.h5"], "some-run is a run in voxels, but Gaussians are needed"),
        (["volume", "some-run", "-o", "x.png"], "x.png: the suffix says the format, one of .h5, .hdf5, .vti"),
        (["volume", "some-run", "-o", "x"], "the output x has no suffix, which means a DICOM CT series"),
        (["volume", "some-run"], "some-run has no scan.json, which older versions did not write"),
        (["fit", "scene.yaml"], "there is no dataset scene.yaml; `phantomgen make scene.yaml` makes one"),
    ],
)
def test_wrong_names_are_refused_before_any_work(arguments, said, folder):
    assert said in refusal(*arguments)
    assert sorted(path.name for path in folder.iterdir()) == ["scan.h5", "some-run"]
