"""Files of volumes: complete, or not there."""

import h5py
import pytest

from recon.output.volume_file import whole_file
from spectra.errors import StorageError


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
