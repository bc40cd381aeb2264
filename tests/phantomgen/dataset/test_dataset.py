"""The dataset file: round trip, foreign readers, and one sentence for every way it can be broken."""

import h5py
import numpy as np
import pytest
from support.edited_datasets import edited_dataset

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.file import DETECTOR
from phantomgen.dataset.layout import new_frames, pack_image, write_image
from phantomgen.dataset.reader import open_dataset, parse_region
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.dataset.validate import validate
from phantomgen.dataset.writing.writer import DatasetWriter
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import DatasetError, InputError
from spectra.materials.material import Material

EDGES = np.linspace(20.0, 140.0, 13)
BASIS = Basis((BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("step", edge_energy=60.0)))
GEOMETRY = Geometry.circular(500.0, 800.0, np.deg2rad([0.0, 90.0, 180.0, 45.0]), Panel(6, 8, (0.7, 0.8)))
GRID = Grid((2, 3, 4), (1.0, 2.0, 3.0), (-0.5, -2.0, -4.5))
COUNTS = np.random.default_rng(0).poisson(1000.0, (4, 2, 6, 8)).astype(np.int32)
FLATS = np.random.default_rng(1).poisson(2000.0, (3, 2, 6, 8)).astype(np.int32)


def spectra() -> Spectra:
    energy = (EDGES[1:] + EDGES[:-1]) / 2
    response = np.where((energy < 60) == np.array([[True], [False]]), 0.9, 0.0)
    source = np.linspace(5.0, 1.0, 12)
    limits = np.array([20.0, 60.0]), np.array([60.0, 140.0])
    return Spectra(energy, EDGES, source, response, BASIS, BASIS.evaluate(energy), ("bin0", "bin1"), *limits)


def truth() -> Truth:
    fractions = np.random.default_rng(2).dirichlet([1.0, 1.0, 1.0], (2, 3, 4))[..., :2].astype(np.float32)
    coefficients = np.array([[0.01, 0.02, 0.0], [0.0, 0.01, 0.03]])
    return Truth.of(GRID, BASIS.names, ("a", "b"), coefficients, np.moveaxis(fractions, -1, 0), "version: 1\n")


def write(path, counts=COUNTS, noise=True):
    materials = (Material("a", coefficients={"compton": 0.02}), Material("b", 1.0, {"H": 0.112, "O": 0.888}))
    with DatasetWriter(path) as writer:
        views = {"train": np.arange(3), "test": np.array([3]), "val": np.empty(0, int)}
        writer.write_scan("toy", GEOMETRY, spectra(), GRID, views, "sparse3")
        writer.write_instrument(GEOMETRY, spectra(), {"voltage": (140.0, "kV")})
        arrays = writer.new_counts(counts.shape, len(FLATS), 1, noise)
        for name, images in (("data", counts), ("flat", FLATS.astype(counts.dtype))):
            for frame, channel in np.ndindex(*images.shape[:2]):
                write_image(arrays[name], frame, channel, pack_image(images[frame, channel]))
        writer.write_truth(truth(), materials)
        writer.write_process("phantomgen make", 3)
        writer.finish(spectra())
    return path


@pytest.fixture
def path(tmp_path):
    return write(tmp_path / "toy.h5")


def edited(path, edit):
    with edited_dataset(path) as file:
        edit(file)
    return path


def refusal(path, **options) -> str:
    with pytest.raises(DatasetError) as caught, open_dataset(path, **options) as dataset:
        dataset.load()
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_written_is_read(path):
    with open_dataset(path) as dataset:
        assert repr(dataset) == "Dataset(toy: 4 views x 2 channels x 6 x 8, 20..140 keV)"
        assert np.array_equal(dataset.load(), COUNTS)
        assert np.array_equal(dataset.load([3, 1]), COUNTS[[3, 1]])
        assert dataset.geometry == GEOMETRY
        assert dataset.geometry.angles == pytest.approx(GEOMETRY.angles)
        assert dataset.geometry.kind == "circular"
        assert dataset.grid == GRID
        assert dataset.flat == pytest.approx(FLATS.mean(axis=0))
        assert not dataset.dark.any()
        assert {name: views.tolist() for name, views in dataset.splits.items()} == {
            "train": [0, 1, 2],
            "test": [3],
            "val": [],
        }
        assert dataset.exposure.tolist() == [[1.0] * 2] * 4
        for name in ("energy", "edges", "source", "response", "basis_values", "lower", "upper"):
            assert np.array_equal(getattr(dataset.spectra, name), getattr(spectra(), name))
        assert dataset.spectra.basis == BASIS
        assert dataset.spectra.transmission().open_beam == pytest.approx(spectra().weights.sum(axis=1))


def test_truth_is_read_back_and_consistent(path):
    found, wanted = read_truth(path), truth()
    assert found is not None
    for name in ("volumes", "fractions", "coefficients"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name))
    assert (found.grid, found.basis_names, found.material_names) == (GRID, BASIS.names, ("a", "b"))
    from_fractions = np.einsum("mb,mzyx->bzyx", found.coefficients, found.fractions / 65535)
    assert found.volumes == pytest.approx(from_fractions, abs=1e-6)


def test_labels_name_what_fills_most_of_a_voxel():
    wanted = truth()
    background = 65535 - wanted.fractions.sum(axis=0, dtype=np.int64)
    parts = np.concatenate([background[None], wanted.fractions])
    assert np.array_equal(np.take_along_axis(parts, wanted.labels[None].astype(int), 0)[0], parts.max(axis=0))


def test_a_dataset_without_truth_reads_the_same(path):
    edited(path, lambda file: file.__delitem__("truth"))
    assert read_truth(path) is None
    with open_dataset(path) as dataset:
        assert np.array_equal(dataset.load(), COUNTS)
    assert validate(path) == []


def test_nothing_in_entry_speaks_of_the_object(path):
    seen = []
    with h5py.File(path) as file:
        file["entry"].visititems(
            lambda name, item: seen.append((name, str(item[()] if hasattr(item, "shape") else "")))
        )
    assert not any("compton: 0.02" in text or "/truth" in text for _, text in seen)


@pytest.mark.parametrize("dtype", [np.int32, np.float32])
@pytest.mark.parametrize("shape", [(5, 7), (1, 1), (700, 2048)])
def test_packed_images_are_what_the_library_unpacks(tmp_path, dtype, shape):
    images = np.random.default_rng(0).integers(0, 5000, (2, 1, *shape)).astype(dtype)
    with h5py.File(tmp_path / "images.h5", "w") as file:
        dataset = new_frames(file, "data", images.shape, dtype, "counts")
        for frame in range(2):
            write_image(dataset, frame, 0, pack_image(images[frame, 0]))
        assert np.array_equal(dataset[()], images)
        assert np.prod(dataset.chunks) * dataset.dtype.itemsize <= 4 << 20


@pytest.mark.filterwarnings("ignore")  # of the foreign library, about fields that are optional
def test_nxtomo_reads_each_channel(path):
    nxtomo = pytest.importorskip("nxtomo")
    moved = path.rename(path.with_name("moved.h5"))
    scan = nxtomo.NXtomo().load(str(moved), "/nxtomo_bin1")
    keys = np.array([key.value for key in scan.instrument.detector.image_key_control])
    assert keys.tolist() == [1] * 3 + [0] * 4 + [2]
    angles = np.asarray(scan.sample.rotation_angle.to("degree").magnitude)
    assert angles[keys == 0] == pytest.approx([0.0, -90.0, -180.0, -45.0])
    assert scan.energy.to("keV").magnitude == pytest.approx(spectra().effective_energy[1])
    assert scan.instrument.detector.x_pixel_size.to("mm").magnitude == pytest.approx(0.8)
    with h5py.File(moved) as file:
        frames = file["nxtomo_bin1/instrument/detector/data"][()]
    assert np.array_equal(frames[keys == 0], COUNTS[:, 1])
    assert np.array_equal(frames[keys == 1], FLATS[:, 1])


def test_counts_without_noise_have_no_nxtomo_entries(tmp_path):
    path = write(tmp_path / "mean.h5", COUNTS.astype(np.float32) + np.float32(0.25), noise=False)
    assert validate(path) == []
    assert describe(path)["nxtomo"] == []
    assert "it knows integer counts only" in describe_text(describe(path))


def test_the_same_input_gives_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1700000000")
    assert write(tmp_path / "a.h5").read_bytes() == write(tmp_path / "b.h5").read_bytes()
    assert "2023-11-14T22:13:20Z" in describe(tmp_path / "a.h5")["made_by"]


def test_an_interrupted_dataset_leaves_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt), DatasetWriter(tmp_path / "a.h5"):
        raise KeyboardInterrupt
    assert list(tmp_path.iterdir()) == []


def test_outputs_that_cannot_be_are_refused_at_once(path, tmp_path):
    with pytest.raises(InputError, match="exists: choose another name by --out, or add --overwrite"):
        DatasetWriter(path)
    with pytest.raises(InputError, match="is a folder"):
        DatasetWriter(tmp_path)
    with pytest.raises(InputError, match=r"folder .* does not exist"):
        DatasetWriter(tmp_path / "none" / "a.h5")


@pytest.mark.parametrize("kept", [0.05, 0.5, 0.98])
def test_a_truncated_file_is_refused(path, kept):
    data = path.read_bytes()
    path.write_bytes(data[: int(kept * len(data))])
    assert "cut off" in refusal(path) or "damaged" in refusal(path)


def test_damaged_counts_are_refused_when_read(path):
    with h5py.File(path) as file:
        chunk = file[f"{DETECTOR}/data"].id.get_chunk_info(3)
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset : chunk.byte_offset + chunk.size] = b"\xff" * chunk.size
    path.write_bytes(data)
    assert refusal(path) == f"{path}: {DETECTOR}/data[1] cannot be read: the file is damaged"


def test_other_files_are_refused(tmp_path):
    (tmp_path / "text.h5").write_text("no HDF5")
    assert "damaged or not an HDF5 file" in refusal(tmp_path / "text.h5")
    h5py.File(tmp_path / "other.h5", "w").close()
    assert "is not a spectral-ct dataset" in refusal(tmp_path / "other.h5")
    assert refusal(tmp_path / "none.h5") == f"there is no dataset {tmp_path / 'none.h5'}"


def test_a_newer_schema_is_refused_and_a_newer_minor_one_is_read(path):
    edited(path, lambda file: file.attrs.__setitem__("schema_version", "2.0"))
    assert "has schema version 2.0, this program knows 1.1: update it" in refusal(path)
    edited(path, lambda file: file.attrs.__setitem__("schema_version", "1.7"))
    assert validate(path) == []
    assert "schema version 1.7" in describe(path)["warnings"][0]


def replaced(file, name, values):
    del file[name]
    file[name] = values
    file[name].attrs["units"] = "counts"


@pytest.mark.parametrize(("value", "expected"), [(np.nan, "not a number"), (-3.0, "negative counts, down to -3")])
def test_impossible_counts_are_refused(path, value, expected):
    counts = COUNTS.astype(np.float32)
    counts[2, 1, 3, 4] = value
    edited(path, lambda file: replaced(file, f"{DETECTOR}/data", counts))
    assert expected in refusal(path)
    assert "view 2" in refusal(path)
    assert any(expected in problem for problem in validate(path))


def test_missing_flats_offer_a_region_of_air(path):
    edited(path, lambda file: file.__delitem__("entry/instrument/flat"))
    assert "has no flat field" in refusal(path)
    assert "--air rows,columns" in refusal(path)
    with open_dataset(path, air="0:2,0:8") as dataset:
        assert dataset.flat[:, 5, 5] == pytest.approx(COUNTS[:, :, :2].mean(axis=(0, 2, 3)))
    assert validate(path, "0:2,0:8") == []
    assert describe(path)["flats"] == 0


@pytest.mark.parametrize("text", ["", "1:2", "0:2,3", "a:b,c:d", "2:1,0:1", "-1:2,0:1", "0:1,0:1,0:1"])
def test_regions_of_air_are_checked(text):
    with pytest.raises(InputError, match="region of air"):
        parse_region(text)


def test_a_region_of_air_beyond_the_panel_is_refused(path):
    with pytest.raises(InputError, match="beyond the panel of 6 x 8"):
        open_dataset(path, air="0:7,0:8")


@pytest.mark.parametrize(
    ("edit", "expected"),
    [
        (lambda f: f["entry/spectra/response"].__setitem__((0, 0), -1.0), "response holds -1, expected numbers from 0"),
        (lambda f: f["entry/spectra/energy_edges"].__setitem__(3, 5.0), "energy_edges must ascend"),
        (lambda f: f["entry/spectra/basis"].__setitem__((0, 0), 9.0), "basis is not what"),
        (lambda f: f["entry/geometry/row_step"].__setitem__((1, 2), 9.0), "row_step has length"),
        (lambda f: f["entry/splits/sparse3/test"].__setitem__(0, 2), "view 2 is in split train and in split test"),
        (lambda f: f[f"{DETECTOR}/x_pixel_size"].attrs.__setitem__("units", "m"), "must have units='mm', found 'm'"),
        (lambda f: f["truth/basis/data"].__setitem__((0, 0, 0, 0), np.nan), "/truth/basis/data"),
        (lambda f: f.__delitem__("truth/grid"), "lacks /truth/grid/shape"),
    ],
)
def test_validate_names_what_is_wrong(path, edit, expected):
    problems = validate(edited(path, edit))
    assert len(problems) == 1
    assert expected in problems[0]


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("entry/geometry/source", "lacks /entry/geometry/source"),
        (f"{DETECTOR}/data", f"lacks {DETECTOR}/data"),
        ("entry/splits", "lacks /entry/splits"),
    ],
)
def test_a_missing_part_is_named(path, name, expected):
    edited(path, lambda file: file.__delitem__(name))
    with pytest.raises(DatasetError, match=expected), open_dataset(path) as dataset:
        assert dataset.splits


def test_splits_outside_the_views_are_refused(path):
    edited(path, lambda file: file["entry/splits/sparse3/test"].__setitem__(0, 4))
    with open_dataset(path) as dataset, pytest.raises(DatasetError, match=r"names a view outside 0\.\.3"):
        assert dataset.splits
