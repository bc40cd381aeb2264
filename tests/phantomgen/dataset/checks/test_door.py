"""Nothing is read from other files, whatever a dataset links to."""

import os
import shutil

import h5py
import numpy as np
import pytest
from support.edited_datasets import edited_dataset
from support.tiny_scans import make, one_sentence

from phantomgen.dataset.checks.door import array_at, find_array, find_group, has, value_at
from phantomgen.dataset.file import DETECTOR
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from recon.cli.main import main as recon
from spectra.errors import DatasetError

COUNTS, SOURCE = f"{DETECTOR}/data", "entry/spectra/source"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return make(tmp_path_factory.mktemp("scan") / "scan.h5", "--views", "4")


@pytest.fixture
def scan(whole, tmp_path):
    return shutil.copy(whole, tmp_path / "scan.h5")


def external(file, name):
    old = file[name]
    shape, dtype, size = old.shape, old.dtype, old.size * old.dtype.itemsize
    units = dict(old.attrs)
    del file[name]
    file.create_dataset(name, shape, dtype, external=[("/dev/zero", 0, size)]).attrs.update(units)


def virtual(file, name):
    other = f"{file.filename}.other"
    values, units = file[name][()], dict(file[name].attrs)
    with h5py.File(other, "w") as source:
        source["data"] = values
    layout = h5py.VirtualLayout(values.shape, values.dtype)
    layout[...] = h5py.VirtualSource(other, "data", values.shape)
    del file[name]
    file.create_virtual_dataset(name, layout).attrs.update(units)


def link_of(target):
    def edit(file, name):
        del file[name]
        file[name] = target

    return edit


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (external, "has its values in other files, such as /dev/zero"),
        (virtual, "is put together from other arrays"),
        (link_of(h5py.ExternalLink("/dev/zero", "/a")), "is a link into another file, /dev/zero"),
        (link_of(h5py.SoftLink("/truth/basis/data")), "is a link to /truth/basis/data, out of /entry"),
        (link_of(h5py.SoftLink("/entry/round")), "is a link that leads back to itself"),
    ],
)
@pytest.mark.parametrize("name", [COUNTS, SOURCE])
def test_data_of_other_places_are_refused(edit, message, name, scan):
    with edited_dataset(scan) as file:
        file["entry/round"] = h5py.SoftLink("/entry/round")
        edit(file, name)
    for action in (open_dataset, validate):
        with pytest.raises(DatasetError, match=message):
            action(scan)


def test_a_fit_refuses_them_in_one_sentence(scan, tmp_path):
    from click.testing import CliRunner

    with edited_dataset(scan) as file:
        external(file, COUNTS)
    result = CliRunner().invoke(recon, ["fit", str(scan), "-o", str(tmp_path / "run")])
    sentence = one_sentence(result)
    assert "data has its values in other files, such as /dev/zero: copy its values into the file" in sentence
    assert not os.path.lexists(tmp_path / "run")


@pytest.mark.parametrize("name", ["truth/labels", "truth/basis/data", "entry/sample/name"])
def test_validate_finds_them_where_no_reader_goes(name, scan):
    with edited_dataset(scan) as file:
        del file[name]
        file[name] = h5py.ExternalLink("other.h5", "/a")
    assert any(f"/{name} is a link into another file, other.h5" in sentence for sentence in validate(scan))


def test_groups_in_other_files_are_refused(scan, tmp_path):
    other = tmp_path / "other.h5"
    shutil.copy(scan, other)
    with edited_dataset(scan) as file:
        del file["entry/spectra"]
        file["entry/spectra"] = h5py.ExternalLink(str(other), "/entry/spectra")
    with pytest.raises(DatasetError, match="/entry/spectra/energy is a link into another file"):
        open_dataset(scan)
    with h5py.File(scan, "r+") as file:
        del file["truth"]
        file["truth"] = h5py.ExternalLink(str(other), "/truth")
    with pytest.raises(DatasetError, match="/truth is a link into another file"):
        read_truth(scan)


def test_what_is_missing_or_of_another_kind_is_told_apart(tmp_path):
    with h5py.File(tmp_path / "some.h5", "w") as file:
        file["group/number"] = 3
        file["group/text"] = np.array(["a", "b"], dtype=object)
        file["link"] = h5py.SoftLink("/group/number")
        file["wrong"] = np.array([b"\xff\xfe"], dtype="S2")
        assert value_at(file, "link") == 3
        assert value_at(file["group"], "text").tolist() == ["a", "b"]
        assert find_group(file, "link") is None
        assert find_array(file, "group") is None
        assert find_array(file, "group/number/below") is None
        assert (has(file, "group"), has(file, "group/none")) == (True, False)
        with pytest.raises(DatasetError, match="lacks /group/none"):
            array_at(file, "group/none")
        with pytest.raises(DatasetError, match="/wrong cannot be read"):
            value_at(file, "wrong")
