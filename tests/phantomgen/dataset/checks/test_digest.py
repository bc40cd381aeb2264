"""A dataset is as it was written, or a sentence says which part is not."""

import shutil
import struct

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make

from phantomgen.cli.main import main
from phantomgen.dataset.checks.digest import DIGESTS, missing_chunks, seal_problems
from phantomgen.dataset.checks.fletcher import fletcher32
from phantomgen.dataset.file import DETECTOR, FLAT
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from spectra.errors import DatasetError

COUNTS = f"{DETECTOR}/data"


@pytest.fixture(scope="module", params=["gzip", "none"])
def whole(request, tmp_path_factory):
    return make(tmp_path_factory.mktemp("scan") / "scan.h5", "--views", "4", "--compression", request.param)


@pytest.fixture
def scan(whole, tmp_path):
    return shutil.copy(whole, tmp_path / "scan.h5")


@pytest.mark.parametrize("size", [1, 2, 7, 1000, 1001, 200_001])
@pytest.mark.parametrize("most", [1, 2, 256])
def test_checksums_are_those_of_hdf5(size, most):
    data = np.random.default_rng(size).integers(0, most, size).astype(np.uint8)
    with h5py.File("chunk", "w", driver="core", backing_store=False) as file:
        chunk = file.create_dataset("data", data=data, chunks=data.shape, fletcher32=True).id.read_direct_chunk((0,))[1]
    assert chunk == data.tobytes() + fletcher32(data.tobytes())


def test_every_chunk_has_a_checksum(whole):
    arrays = []
    with h5py.File(whole) as file:
        file.visititems(lambda _, item: arrays.append(item) if isinstance(item, h5py.Dataset) else None)
        chunked = [array for array in arrays if array.chunks]
        assert {array.name for array in chunked} >= {COUNTS, FLAT, "/truth/basis/data", "/truth/labels"}
        assert all(array.fletcher32 for array in chunked)
    assert validate(whole) == []


@pytest.mark.parametrize(("name", "part"), [(COUNTS, "view 1"), (FLAT, "flat")])
def test_a_changed_byte_of_a_frame_is_noticed(scan, name, part):
    with h5py.File(scan) as file:
        chunk = file[name].id.get_chunk_info_by_coord((1, 2, 0, 0))
    with scan.open("r+b") as file:
        file.seek(chunk.byte_offset + 5)
        byte = file.read(1)[0]
        file.seek(chunk.byte_offset + 5)
        file.write(bytes([byte ^ 4]))
    assert any("cannot be read: the file is damaged" in sentence for sentence in validate(scan))
    with open_dataset(scan) as dataset, pytest.raises(DatasetError, match="damaged"):
        _ = dataset.load() if part == "view 1" else dataset.flat


def test_a_chunk_that_the_index_lost_is_no_zeros(scan):
    with h5py.File(scan) as file:
        chunk = file[COUNTS].id.get_chunk_info_by_coord((1, 2, 0, 0))
    data = scan.read_bytes()
    entry = struct.pack("<Q", chunk.byte_offset)
    assert data.count(entry) == 1
    place = data.find(entry)
    for damaged in (place - 40, place):  # which view it is of, and where it is
        scan.write_bytes(data[:damaged] + bytes([data[damaged] ^ 8]) + data[damaged + 1 :])
        with pytest.raises(DatasetError, match="damaged"), open_dataset(scan) as dataset:
            dataset.load()
        with pytest.raises(DatasetError, match="damaged"):
            raise DatasetError(" ".join(validate(scan)))


def test_frames_without_their_chunks_are_refused_without_digests_too(scan):
    with h5py.File(scan, "r+") as file:
        frames = file[COUNTS]
        shape, chunks, first = frames.shape, frames.chunks, frames[0]
        del file[COUNTS]
        file.create_dataset(COUNTS, shape, np.int32, chunks=chunks)[0] = first
        for group in (file, *file.values()):
            del group.attrs[DIGESTS]
        assert missing_chunks(file[COUNTS]) == (shape[0] - 1) * shape[1]
    with pytest.raises(DatasetError, match=r"data lacks \d+ of its chunks, which would read as zeros"):
        open_dataset(scan)


def test_files_of_earlier_versions_have_no_digests(scan):
    with h5py.File(scan, "r+") as file:
        for group in (file, *file.values()):
            del group.attrs[DIGESTS]
        file.attrs["schema_version"] = "1.0"
    assert validate(scan) == []


@pytest.mark.parametrize(
    ("part", "edit"),
    [
        ("spectra", lambda file: file["entry/spectra/source"].__setitem__(3, 1.0)),
        ("exposure", lambda file: file["entry/exposure/scale"].__setitem__(0, 1.5)),
        ("instrument", lambda file: file[f"{DETECTOR}/x_pixel_size"].__setitem__((), 0.7)),
        ("instrument", lambda file: file[COUNTS].attrs.__setitem__("units", "keV")),
        ("title", lambda file: file["entry/title"].__setitem__((), "another")),
        ("data", lambda file: file.move("entry/spectra", "entry/data/spectra")),
    ],
)
def test_a_change_is_named_until_it_is_accepted(scan, part, edit):
    with h5py.File(scan, "r+") as file:
        edit(file)
    with pytest.raises(DatasetError, match=rf"/entry has a part {part} that is damaged, or not as it was written"):
        open_dataset(scan)
    result = CliRunner().invoke(main, ["validate", str(scan)])
    assert (result.exit_code, result.stdout) == (1, "")
    CliRunner().invoke(main, ["validate", str(scan), "--seal"])
    with h5py.File(scan) as file:
        assert list(seal_problems(file)) == []


def test_a_damaged_truth_is_found_by_who_reads_it(scan):
    with h5py.File(scan, "r+") as file:
        file["truth/materials/coefficients"][0, 0] += 1e-3
    with open_dataset(scan):
        pass
    with pytest.raises(DatasetError, match="/truth has a part materials that is damaged"):
        read_truth(scan)
    assert len(validate(scan)) == 2


def test_a_scan_without_truth_is_whole(scan):
    with h5py.File(scan, "r+") as file:
        del file["truth"]
    assert validate(scan) == []


def test_what_was_added_is_told_by_validate(scan):
    with h5py.File(scan, "r+") as file:
        file["more"] = 1
    with open_dataset(scan):
        pass
    assert validate(scan) == [f"{scan}: /more was not there when the file was written"]
