import json

import pytest
import torch
from safetensors.torch import save_file
from support.gaussian_scenes import NAMES, circular, small_model

from phantomgen.geometry.voxel_grid import Grid
from recon.gaussians.model import Gaussians
from spectra.errors import DatasetError

PARTS = ("centres", "log_scales", "quaternions", "coefficients")


def test_what_is_saved_is_what_is_loaded(tmp_path):
    gaussians = small_model(1)
    gaussians.save(tmp_path / "model.safetensors")
    loaded = Gaussians.load(tmp_path / "model.safetensors")
    assert loaded.basis_names == NAMES
    assert all(torch.equal(getattr(loaded, name), getattr(gaussians, name)) for name in PARTS)


def test_the_same_model_is_saved_as_the_same_bytes(tmp_path):
    files = [tmp_path / f"{i}.safetensors" for i in range(8)]
    for file in files:
        small_model(1).save(file)
    assert len({file.read_bytes() for file in files}) == 1


def write_text(path):
    path.write_text("solid cube")


def write_foreign_tensors(path):
    save_file({"weight": torch.zeros(3)}, path, metadata={"format": "pt"})


def write_basis_that_is_no_list(path):
    save_file({name: torch.zeros(1, 3) for name in PARTS}, path, metadata={"gaussians": "photoelectric"})


def write_without_rotations(path):
    tensors = {name: torch.zeros(1, 3) for name in PARTS if name != "quaternions"}
    save_file(tensors, path, metadata={"gaussians": json.dumps({"basis": NAMES})})


@pytest.mark.parametrize(
    "write",
    [lambda path: None, write_text, write_foreign_tensors, write_basis_that_is_no_list, write_without_rotations],
    ids=["missing", "text", "foreign tensors", "no list", "no rotations"],
)
def test_a_foreign_file_is_refused_in_one_sentence(write, tmp_path):
    path = tmp_path / "other.safetensors"
    write(path)
    with pytest.raises(DatasetError, match="not a Gaussian model written by recon") as caught:
        Gaussians.load(path)
    assert "\n" not in str(caught.value)


def test_a_detached_copy_shares_nothing():
    gaussians = small_model(2)
    copy = gaussians.detached()
    copy.centres.add_(1)
    assert not torch.equal(copy.centres, gaussians.centres)


def test_shapes_names_and_text():
    gaussians, geometry = small_model(3, count=5, bases=2), circular(5, 6)
    assert gaussians.line_integrals(geometry).shape == (3, 2, 5, 6)
    assert gaussians.volume(Grid.cube(4, 8.0)).shape == (2, 4, 4, 4)
    assert repr(gaussians) == "Gaussians(5 with photoelectric, compton)"
