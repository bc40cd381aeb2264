"""Volumes of every format lie where their library says, and files that are wrong are refused in one sentence."""

import sys
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from phantomgen.exporters.nifti import write_nifti
from phantomgen.exporters.volumes import Volumes
from phantomgen.exporters.vti import write_vti
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.placement import Placement, placed
from phantomgen.volume_files.read import read_volume
from spectra.errors import InputError, NotInstalledError

GRID = Grid((4, 5, 6), (2.0, 1.5, 1.0), (-5.0, 4.0, 3.0))
VALUES = np.random.default_rng(0).integers(-900, 1500, GRID.shape).astype(np.int16)  # no symmetry
TO_ITK = np.array([-1.0, -1.0, 1.0])  # ITK counts to the left and to the back


def itk_image(values=VALUES, grid=GRID, scan=False):
    """An image of SimpleITK, in patient coordinates or in those of the scan."""
    itk = pytest.importorskip("SimpleITK")
    image = itk.GetImageFromArray(values)
    image.SetSpacing(grid.spacing[::-1])
    signs = np.ones(3) if scan else TO_ITK
    image.SetDirection(np.diag(signs).ravel().tolist())
    image.SetOrigin((signs * grid.origin[::-1]).tolist())
    return image


def write_series(folder: Path, leave_out=(), rescale_type="HU"):
    """A DICOM series; its rows and columns run to the left and back as in clinical files."""
    itk = pytest.importorskip("SimpleITK")
    folder.mkdir(exist_ok=True)
    lps = VALUES[:, ::-1, ::-1]  # first pixel at the smallest L and P, which are our largest x and y
    x, y = (GRID.origin[i] + (GRID.shape[i] - 1) * GRID.spacing[i] for i in (2, 1))
    writer = itk.ImageFileWriter()
    writer.KeepOriginalImageUIDOn()
    for z in set(range(len(lps))) - set(leave_out):
        image = itk.GetImageFromArray(lps[z : z + 1])
        image.SetSpacing(GRID.spacing[::-1])
        place = f"{-x}\\{-y}\\{GRID.origin[0] + z * GRID.spacing[0]}"
        entries = {"0008|0060": "CT", "0020|000d": "1.2.3", "0020|000e": "1.2.3.4", "0008|0018": f"1.2.3.4.{z + 1}"}
        entries |= {"0020|0032": place, "0020|0037": "1\\0\\0\\0\\1\\0", "0020|0013": str(z), "0028|1054": rescale_type}
        for key, value in entries.items():
            image.SetMetaData(key, value)
        writer.SetFileName(str(folder / f"{9 - z}.dcm"))  # names tell nothing
        writer.Execute(image)
    return folder


def write(folder: Path, kind: str) -> str:
    """Write `VALUES` on `GRID` by the library of a format, and return the name of the file."""
    name = f"volume.{kind}"
    if kind in ("mha", "nrrd"):
        pytest.importorskip("SimpleITK").WriteImage(itk_image(), str(folder / name))
    elif kind == "nii.gz":
        nibabel = pytest.importorskip("nibabel")
        nibabel.save(nibabel.Nifti1Image(VALUES.T, GRID.affine), folder / name)  # RAS+, as our own axes
    elif kind == "vti":
        write_vti(folder / name, Volumes(GRID, {"hu": VALUES}, "numbers [HU]"))
    elif kind == "cells.vti":
        pyvista = pytest.importorskip("pyvista")
        corner = np.array(GRID.origin[::-1]) - np.array(GRID.spacing[::-1]) / 2
        image = pyvista.ImageData(dimensions=np.array(GRID.shape[::-1]) + 1, spacing=GRID.spacing[::-1], origin=corner)
        image.cell_data["hu"] = VALUES.ravel()
        image.save(folder / name)
    elif kind == "h5":
        with h5py.File(folder / name, "w") as file:
            file.attrs["default"] = "plot"
            plot = file.create_group("plot")
            plot.attrs.update({"signal": "data", "axes": ["x", "y", "z"]})
            plot["data"] = VALUES.T
            for axis in "zyx":
                plot[axis] = GRID.axis(axis)
                plot[axis].attrs["units"] = "mm"
    elif kind == "dicom":
        return str(write_series(folder / name))
    return str(folder / name)


@pytest.mark.parametrize("kind", ["mha", "nrrd", "nii.gz", "vti", "cells.vti", "h5", "dicom"])
def test_a_volume_lies_where_its_library_wrote_it(tmp_path, kind):
    values, grid = placed("volume", read_volume(write(tmp_path, kind)), Placement())
    np.testing.assert_array_equal(values[0], VALUES)
    np.testing.assert_allclose(grid.spacing, GRID.spacing, rtol=1e-6)
    np.testing.assert_allclose(grid.origin, GRID.origin, rtol=1e-6)


def test_images_in_coordinates_of_the_scan_are_read_as_such_when_asked(tmp_path):
    pytest.importorskip("SimpleITK").WriteImage(itk_image(scan=True), str(tmp_path / "scan.mha"))
    volume = read_volume(str(tmp_path / "scan.mha"))
    values, grid = placed("volume", volume, Placement(coordinates="scan"))
    np.testing.assert_array_equal(values[0], VALUES)
    np.testing.assert_allclose(grid.origin, GRID.origin)
    as_patient, _ = placed("volume", volume, Placement())
    np.testing.assert_array_equal(as_patient[0], VALUES[:, ::-1, ::-1])


@pytest.mark.parametrize("axes", ["zyx", "xyz", "yxz", "z-yx", "-x-y-z", "czyx", "zyxc"])
def test_stated_axes_are_exact(tmp_path, axes):
    letters = axes.replace("-", "")
    values = VALUES if "c" not in axes else np.stack([VALUES, 2 * VALUES])
    stored = values.transpose([("c" * ("c" in axes) + "zyx").index(letter) for letter in letters])
    first = dict(zip("zyx", GRID.origin, strict=True))
    for i, letter in enumerate(letters):
        if f"-{letter}" in axes:
            stored = np.flip(stored, i)
            n = "zyx".index(letter)
            first[letter] += (GRID.shape[n] - 1) * GRID.spacing[n]
    np.save(tmp_path / "volume.npy", stored)
    stated = Placement(axes, GRID.spacing, (first["z"], first["y"], first["x"]))
    found, grid = placed("volume", read_volume(str(tmp_path / "volume.npy")), stated)
    np.testing.assert_array_equal(found, values.reshape(-1, *GRID.shape))
    assert grid == GRID
    assert placed("volume", read_volume(str(tmp_path / "volume.npy")), Placement(axes, grid=GRID))[1] == GRID


def test_a_volume_around_the_isocentre():
    volume = read_volume_of(VALUES)
    assert placed("volume", volume, Placement("zyx", (1.0, 1.0, 2.0), "center"))[1].origin == (-1.5, -2.0, -5.0)


def read_volume_of(values):
    from phantomgen.volume_files.volume import Volume

    return Volume(values)


def test_tiff_pages_and_slices(tmp_path):
    tifffile = pytest.importorskip("tifffile")
    options = {"imagej": True, "resolution": (1.0, 1 / 1.5), "metadata": {"spacing": 2.0, "unit": "mm", "axes": "ZYX"}}
    tifffile.imwrite(tmp_path / "stack.tif", VALUES.astype(np.float32), **options)
    volume = read_volume("stack.tif", tmp_path)
    np.testing.assert_array_equal(volume.values, VALUES)
    np.testing.assert_allclose(volume.spacing, GRID.spacing[::-1], rtol=1e-4)
    assert volume.directions is None
    (tmp_path / "slices").mkdir()
    for z, image in enumerate(np.repeat(VALUES, 3, axis=0)):
        tifffile.imwrite(tmp_path / "slices" / f"s{z}.tif", image)  # s10 comes after s9
    volume = read_volume("slices", tmp_path)
    np.testing.assert_array_equal(volume.values, np.repeat(VALUES, 3, axis=0))
    assert volume.spacing is None


def test_units_and_names_come_from_files_that_state_them(tmp_path):
    both = {"photoelectric": VALUES.astype(np.float32), "compton": 2 * VALUES.astype(np.float32)}
    about = "basis coefficients [1/mm]: photoelectric, compton"
    write_vti(tmp_path / "both.vti", Volumes(GRID, both, about))
    volume = read_volume("both.vti", tmp_path)
    assert (volume.names, volume.units) == (("photoelectric", "compton"), "1/mm")
    np.testing.assert_array_equal(read_volume("both.vti:compton", tmp_path).values, 2 * VALUES)
    pytest.importorskip("nibabel"), pytest.importorskip("SimpleITK")
    write_nifti(tmp_path / "one.nii", Volumes(GRID, {"compton": VALUES}, about))
    assert read_volume("one.nii", tmp_path).units == "1/mm"
    assert read_volume(str(write_series(tmp_path / "hu"))).units == "HU"
    assert read_volume(str(write_series(tmp_path / "us", rescale_type="US"))).units is None


def test_archives_of_arrays(tmp_path):
    np.savez(tmp_path / "two.npz", a=VALUES, b=2 * VALUES)
    np.savez_compressed(tmp_path / "one.npz", VALUES)
    np.testing.assert_array_equal(read_volume("two.npz:b", tmp_path).values, 2 * VALUES)
    np.testing.assert_array_equal(read_volume("one.npz", tmp_path).values, VALUES)
    for name, words in {
        "two.npz": r"which of its arrays\? Write two.npz:NAME, one of a, b",
        "two.npz:c": "no array c, only a, b",
    }.items():
        with pytest.raises(InputError, match=words):
            read_volume(name, tmp_path)


def test_a_turned_image_and_a_missing_slice_are_refused(tmp_path):
    image = itk_image()
    angle = np.radians(2.0)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    image.SetDirection(turn.ravel().tolist())
    pytest.importorskip("SimpleITK").WriteImage(image, str(tmp_path / "turned.mha"))
    with pytest.raises(InputError, match="turned against those of the scan by 2 degrees"):
        placed("volume", read_volume("turned.mha", tmp_path), Placement())
    with pytest.raises(InputError, match="2 to 4 mm apart, where all distances must be equal: a file may be missing"):
        read_volume(str(write_series(tmp_path / "gap", leave_out=[2])))


class Code:
    """An object whose unpickling would run code."""

    def __reduce__(self):
        return (exec, ("raise SystemExit",))


def wrong_files(folder: Path) -> None:
    np.save(folder / "objects.npy", np.array([[[Code()]]], dtype=object), allow_pickle=True)
    np.savez(folder / "objects.npz", a=np.array([[[Code()]]], dtype=object))
    np.save(folder / "flat.npy", VALUES[0])
    np.save(folder / "empty.npy", VALUES[:0])
    np.save(folder / "complex.npy", VALUES.astype(np.complex64))
    np.save(folder / "nan.npy", np.where(VALUES[1, 2, 3] == VALUES, np.nan, 1.0))
    np.save(folder / "cut.npy", VALUES)
    (folder / "cut.npy").write_bytes((folder / "cut.npy").read_bytes()[:200])
    header = {"descr": "<f4", "fortran_order": False, "shape": (10**6, 10**6, 10**6)}
    with (folder / "huge.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
    with zipfile.ZipFile(folder / "huge.npz", "w") as archive:
        archive.write(folder / "huge.npy", "a.npy")
    with h5py.File(folder / "huge.h5", "w") as file:
        file.create_dataset("a", (10**6, 10**6, 10**6), "f4", chunks=(1, 1000, 1000))
        file["text"] = np.array([[["a"]]], dtype=object)
    (folder / "bytes.h5").write_bytes((folder / "huge.h5").read_bytes()[:100])
    for suffix in ("npy", "npz", "h5", "nii", "nii.gz", "mha", "nrrd", "tif", "vti"):
        (folder / f"text.{suffix}").write_text("no numbers\n")
    write(folder, "vti")
    (folder / "cut.vti").write_bytes((folder / "volume.vti").read_bytes()[:-300])
    write(folder, "mha")
    (folder / "cut.mha").write_bytes((folder / "volume.mha").read_bytes()[:-100])


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("none.npy", "there is no such file"),
        ("objects.npy", "cannot be read as an array of numbers"),
        ("objects.npz", "must hold numbers, got object"),
        ("flat.npy", r"must be \(z, y, x\) or \(part, z, y, x\), got shape \(5, 6\)"),
        ("empty.npy", r"got shape \(0, 5, 6\)"),
        ("complex.npy", "must hold numbers, got complex64"),
        ("nan.npy", "values must be finite, 1 are not"),
        ("cut.npy", "cannot be read as an array of numbers: it is cut off"),
        ("huge.npy", "cannot be read as an array of numbers: it is cut off"),
        ("huge.npz", "3.73e.09 GiB, more than the"),
        ("huge.h5:/a", "3.73e.09 GiB, more than the"),
        ("huge.h5:/text", "must hold numbers, got object"),
        ("huge.h5:/b", "there is no dataset /b"),
        ("huge.h5", "which of its datasets"),
        ("bytes.h5:/a", "cannot be read as HDF5"),
        ("text.npy", "cannot be read as an array of numbers"),
        ("text.npz", "cannot be read as an archive of arrays"),
        ("text.h5:/a", "cannot be read as HDF5"),
        ("text.nii", "cannot be read as an image"),
        ("text.nii.gz", "cannot be read as an image"),
        ("text.mha", "cannot be read as an image"),
        ("text.nrrd", "cannot be read as an image"),
        ("text.tif", "cannot be read as TIFF"),
        ("text.vti", "cannot be read as VTK image data"),
        ("cut.vti", "cannot be read as VTK image data"),
        ("cut.mha", "cannot be read as an image"),
        ("volume.vti:other", "there is no array other, only hu"),
    ],
)
def test_wrong_files_are_one_sentence(tmp_path, capfd, name, words):
    wrong_files(tmp_path)
    capfd.readouterr()
    with pytest.raises(InputError, match=words) as caught:
        read_volume(name, tmp_path)
    assert "\n" not in str(caught.value)
    assert name.partition(":")[0] in str(caught.value)
    said = "".join(capfd.readouterr()).splitlines()
    assert not said or said[0].startswith("MetaImage:")  # that library writes by itself


@pytest.mark.parametrize(
    ("axes", "words"), [("zy", "zyx"), ("zyz", "zyx"), ("zyxx", "zyx"), ("zy+x", "zyx"), ("-czyx", "zyx"), ("", "zyx")]
)
def test_axes_that_mean_nothing(axes, words):
    with pytest.raises(
        InputError, match=f"--axes names the axis of the scan along each axis of the array, such as {words}"
    ):
        Placement(axes)


def test_statements_that_contradict_are_refused():
    with pytest.raises(InputError, match="leave --voxel-mm and --origin-mm out"):
        Placement("zyx", (1.0, 1.0, 1.0), grid=GRID)
    with pytest.raises(InputError, match=r"--voxel-mm: a size must be from 1e-06 to 1e.06 mm, got 1, 0, 1"):
        Placement("zyx", (1.0, 0.0, 1.0))
    with pytest.raises(InputError, match=r"has 5 x 4 x 6 voxels \(z, y, x\), the grid of the dataset has 4 x 5 x 6"):
        placed("volume", read_volume_of(VALUES), Placement("yzx", grid=GRID))


def test_without_a_library_the_sentence_names_the_extra(tmp_path, monkeypatch):
    (tmp_path / "a.mha").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with pytest.raises(NotInstalledError, match=r"pip install 'spectral-ct\[images\]'"):
        read_volume("a.mha", tmp_path)


@pytest.mark.parametrize(
    ("spacing", "origin", "words"),
    [
        ((1.0, 2.0), (0.0, 0.0, 0.0), "/a/grid/spacing must be three numbers"),
        ("text", (0.0, 0.0, 0.0), "/a/grid/spacing must be three numbers"),
        (
            (1.0, 0.0, 1.0),
            (0.0, 0.0, 0.0),
            "the size of a voxel must be from 1e-06 to 1e.06 mm, got 1, 0",
        ),
        ((1.0, np.nan, 1.0), (0.0, 0.0, 0.0), "the size of a voxel must be from"),
        ((1.0, 1.0, 1.0), (0.0, np.inf, 0.0), "the centre of the first voxel must be from"),
    ],
)
def test_places_that_cannot_be_are_refused(tmp_path, spacing, origin, words):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a/v"], file["a/grid/spacing"], file["a/grid/origin"] = VALUES, spacing, origin
    with pytest.raises(InputError, match=words):
        placed("volume", read_volume("a.h5:/a/v", tmp_path), Placement("zyx"))
