"""Arrays of the wrong type, shape or range are one sentence, in every array of the format."""

import re
import shutil

import h5py
import numpy as np
import pytest
from support.edited_datasets import edited_dataset
from support.tiny_scans import make

from phantomgen.dataset.checks.fields import ENTRY, TRUTH, schema_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from spectra.errors import DatasetError

CHANNEL = "bin0"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return make(tmp_path_factory.mktemp("scan") / "scan.h5", "--views", "4")


@pytest.fixture
def scan(whole, tmp_path):
    return shutil.copy(whole, tmp_path / "scan.h5")


def path_of(field, file):
    return field.path.replace("<channel>", CHANNEL).replace("<scheme>", next(iter(file["entry/splits"])))


def read(path, field):
    return read_truth(path) if field in TRUTH else open_dataset(path).close()


def replaced(scan, field, change):
    """Replace an array by what a function makes of its values; False where the file has no such array."""
    with edited_dataset(scan) as file:
        name = path_of(field, file)
        if name not in file:
            return False
        values, attributes = file[name][()], dict(file[name].attrs)
        changed = change(values)
        if changed is None:
            return False
        del file[name]
        file[name] = changed
        file[name].attrs.update(attributes)
    return True


@pytest.mark.parametrize("field", [*ENTRY, *TRUTH], ids=lambda field: field.path)
@pytest.mark.wrong_types
def test_other_types_and_shapes_are_refused(field, scan, tmp_path):
    texts, numbers = np.array(["a"], dtype=object), np.zeros(2, complex)
    other = numbers if field.kind == "text" else texts
    for change in (lambda values: other, lambda values: np.array([values, values])):
        copied = shutil.copy(scan, tmp_path / "copied.h5")
        if not replaced(copied, field, change):
            continue
        with pytest.raises(DatasetError, match=r"holds (object|complex128), expected|has shape \(.*\), expected \("):
            read(copied, field)


@pytest.mark.parametrize("field", [*ENTRY, *TRUTH], ids=lambda field: field.path)
@pytest.mark.parametrize("value", [np.nan, 1e38])
def test_impossible_values_are_refused(field, value, scan):
    if field.large or field.kind != "real" or (np.isnan(value) and field.nan):
        return
    last = lambda values: np.concatenate([np.ravel(values)[:-1], [value]]).reshape(np.shape(values))  # noqa: E731
    if not replaced(scan, field, last):
        return
    words = f"{field.path.rsplit('/', 1)[1]} holds {value:g}, expected numbers from"
    with pytest.raises(DatasetError, match=re.escape(words)):
        read(scan, field)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("entry/instrument/detector/x_pixel_size", 0.0),
        ("entry/exposure/scale", -1.0),
        ("entry/reconstruction_grid/spacing", -0.5),
        ("entry/reconstruction_grid/shape", 0),
        ("entry/spectra/energy", 0.0),
        (f"entry/instrument/detector/{CHANNEL}_channel/threshold_energy", -20.0),
    ],
)
def test_signs_are_checked(name, value, scan):
    with edited_dataset(scan) as file:
        file[name][...] = value
    with pytest.raises(DatasetError, match=f"holds {value:g}, expected"):
        open_dataset(scan)
    assert [sentence for sentence in validate(scan) if f"/{name} holds {value:g}, expected" in sentence]


def test_text_that_is_no_text_is_refused(scan):
    with edited_dataset(scan) as file:
        del file["entry/spectra/basis_name"]
        file.create_dataset("entry/spectra/basis_name", data=np.array([b"\xff"] * 3), dtype="S1")
    with pytest.raises(DatasetError, match="/entry/spectra/basis_name cannot be read"):
        open_dataset(scan)


def test_the_schema_names_every_array_of_a_scan(whole):
    text, names = schema_text(), []
    with h5py.File(whole) as file:
        file.visititems(lambda name, item: names.append(f"/{name}") if isinstance(item, h5py.Dataset) else None)
    words = ("/entry/process", "/entry/instrument/source", "/truth/scene", "/truth/plan", "/nxtomo_", "/truth/basis/")
    words += ("/entry/data/view", "/entry/sample/name", "/entry/spectra/channel", "/truth/grid/affine", "/entry/splits")
    channels = [name.replace("bin", "<channel>", 1) for name in names if "_channel/" in name]
    assert channels
    assert [n for n in names if n not in text and not n.startswith(words) and "_channel/" not in n] == []
