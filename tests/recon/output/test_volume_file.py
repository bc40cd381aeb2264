"""Files of volumes: complete, or not there."""

import h5py
import numpy as np
import pytest

from phantomgen.geometry.voxel_grid import Grid
from recon.output.volume_file import chosen_grid, whole_file
from spectra.errors import InputError, StorageError


def test_a_file_gets_its_name_when_it_is_complete(tmp_path):
    path = tmp_path / "volume.h5"
    with whole_file(path) as file:
        file["data"] = [1.0, 2.0]
        assert not path.exists()
    with h5py.File(path) as file:
        assert list(file["data"]) == [1.0, 2.0]
    assert [p.name for p in tmp_path.iterdir()] == ["volume.h5"]


@pytest.mark.parametrize(("error", "raised"), [(OSError(28, "full"), StorageError), (KeyError("x"), KeyError)])
def test_a_file_that_is_not_finished_leaves_the_old_one(tmp_path, error, raised):
    path = tmp_path / "volume.h5"
    path.write_text("old")
    with pytest.raises(raised), whole_file(path):
        raise error
    assert [p.name for p in tmp_path.iterdir()] == ["volume.h5"]
    assert path.read_text() == "old"


def test_a_folder_that_does_not_exist_is_one_sentence(tmp_path):
    with pytest.raises(StorageError, match="cannot be written"), whole_file(tmp_path / "none" / "volume.h5"):
        pass


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"size": "0"}, "--size needs positive sizes in mm, got '0'"),
        ({"size": "-5"}, "--size needs positive sizes in mm, got '-5'"),
        ({"voxel": np.nan}, "--voxel must be a finite size in mm, got nan"),
        ({"voxel": np.inf}, "--voxel must be a finite size in mm, got inf"),
        ({"voxel": 1e-9}, r"a volume of 1e\+10 x 1e\+10 x 1e\+10 voxels is more than"),
        ({"counts": "1e9"}, r"a volume of 1e\+09 x 1e\+09 x 1e\+09 voxels is more than"),
        ({"center": "nan,0,0"}, "--center needs three numbers"),
    ],
)
def test_grids_that_cannot_be_are_refused(options, words):
    given = {"counts": None, "voxel": None, "size": None, "center": None, "like": None} | options
    with pytest.raises(InputError, match=words):
        chosen_grid(Grid.cube(8, 10.0), **given)


@pytest.mark.parametrize(("spacing", "origin"), [(np.nan, 0.0), (np.inf, 0.0), (1.0, np.nan)])
def test_a_grid_has_finite_numbers(spacing, origin):
    with pytest.raises(InputError, match="spacing and origin of a grid must be numbers"):
        Grid((2, 2, 2), (1.0, spacing, 1.0), (origin, 0.0, 0.0))
