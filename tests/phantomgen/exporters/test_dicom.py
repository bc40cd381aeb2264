"""A DICOM CT series, opened by SimpleITK: the same CT numbers at the same millimetres."""

import builtins

import numpy as np
import pytest
import SimpleITK

from phantomgen.exporters.dicom import check_series, write_series
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.read import read_volume
from spectra.errors import InputError, NotInstalledError, StorageError

GRID = Grid((3, 4, 5), (2.0, 1.5, 0.5), (-7.0, 3.0, 11.0))
VALUES = np.random.default_rng(0).uniform(-1000, 3000, GRID.shape)


@pytest.fixture(scope="module")
def series(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dicom") / "hu"
    write_series(folder, GRID, VALUES, "CT numbers at 70 keV")
    return folder


def image_of(folder):
    reader = SimpleITK.ImageSeriesReader()
    reader.SetFileNames(reader.GetGDCMSeriesFileNames(str(folder)))
    return reader.Execute()


@pytest.mark.parametrize("index", [(0, 0, 0), (2, 0, 1), (1, 3, 4)])
def test_every_value_is_at_its_millimetres_to_the_left_and_to_the_back(index, series):
    image = image_of(series)
    z, y, x = index
    point = (-(11.0 + 0.5 * x), -(3.0 + 1.5 * y), -7.0 + 2.0 * z)
    found = image.GetPixel(image.TransformPhysicalPointToIndex(point))
    assert found == pytest.approx(VALUES[index], abs=0.5)
    assert image.GetSpacing() == pytest.approx((0.5, 1.5, 2.0))
    assert image.GetSize() == (5, 4, 3)


def test_pictures_have_the_patients_right_on_the_left_and_anterior_at_the_top(series):
    image = image_of(series)
    assert image.GetDirection() == pytest.approx((1, 0, 0, 0, 1, 0, 0, 0, 1))
    first = SimpleITK.GetArrayFromImage(image)[0]
    np.testing.assert_allclose(first, VALUES[0, ::-1, ::-1], atol=0.5)


def test_our_own_reader_gives_the_volume_back(series):
    volume = read_volume(str(series))
    assert volume.units == "HU"
    origin = np.array(volume.origin)
    corner = origin + volume.directions @ (np.array(volume.spacing) * (np.array(volume.values.shape[::-1]) - 1))
    ends = np.sort([origin, corner], axis=0)
    np.testing.assert_allclose(ends, [[11.0, 3.0, -7.0], [13.0, 7.5, -3.0]])
    np.testing.assert_allclose(volume.values[:, ::-1, ::-1], VALUES, atol=0.5)


def test_headers_are_those_of_a_ct_series(series):
    reader = SimpleITK.ImageFileReader()
    found = []
    for path in sorted(series.iterdir()):
        reader.SetFileName(str(path))
        reader.ReadImageInformation()
        found.append({tag: reader.GetMetaData(tag).strip(" \0") for tag in reader.GetMetaDataKeys()})
    tags = found[0]
    assert tags["0008|0016"] == "1.2.840.10008.5.1.4.1.1.2"
    assert (tags["0008|0060"], tags["0028|1054"], tags["0018|5100"]) == ("CT", "HU", "HFS")
    assert (float(tags["0028|1052"]), float(tags["0028|1053"])) == (0.0, 1.0)
    assert tags["0020|0037"] == "1\\0\\0\\0\\1\\0"
    assert [float(size) for size in tags["0028|0030"].split("\\")] == [1.5, 0.5]  # between rows, between columns
    assert [tags["0020|0013"] for tags in found] == ["1", "2", "3"]
    assert len({tags["0008|0018"] for tags in found}) == 3
    assert len({tags["0020|000e"] for tags in found}) == len({tags["0020|0052"] for tags in found}) == 1
    assert all(len(tags["0008|0018"]) <= 64 for tags in found)


def test_values_beyond_sixteen_bits_are_the_nearest_that_there_are(tmp_path):
    write_series(tmp_path / "s", Grid.cube(2, 2.0), np.array([-1e6, 1e6, 0.4, -0.6] * 2).reshape(2, 2, 2), "test")
    assert sorted(set(read_volume(str(tmp_path / "s")).values.ravel().tolist())) == [-32768, -1, 0, 32767]


def test_values_that_are_not_finite_are_refused_and_leave_no_folder(tmp_path):
    values = VALUES.copy()
    values[1, 1, 1] = np.nan
    with pytest.raises(InputError, match="cannot hold values that are not finite"):
        write_series(tmp_path / "s", GRID, values, "test")
    assert list(tmp_path.iterdir()) == []


def test_only_series_are_replaced(series, tmp_path):
    with pytest.raises(InputError, match="add --overwrite"):
        check_series(series, False)
    check_series(series, True)
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="will not be replaced"):
        check_series(tmp_path, True)
    with pytest.raises(StorageError, match="cannot be written"):
        write_series(tmp_path / "none" / "s", GRID, VALUES, "test")


def test_a_missing_package_is_one_sentence(tmp_path, monkeypatch):
    real = builtins.__import__

    def without(name, *rest):
        if name == "SimpleITK":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(NotInstalledError, match=r"spectral-ct\[images\]"):
        check_series(tmp_path / "s", False)
