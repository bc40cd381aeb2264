"""Broken, foreign and hostile scans: one sentence, exit code 1, nothing written, nothing run."""

import json
import pickle
import struct
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from tests.support import foreign_scans as foreign
from tests.support.foreign_scans import FORMATS
from tests.support.tiny_scans import one_sentence


def said(name: str, path: Path, *options: str) -> str:
    if name == "dicom-ct-pd":
        pytest.importorskip("pydicom")
    before = set(path.parent.rglob("*"))
    out = path.parent / "out.h5"
    result = CliRunner().invoke(phantomgen, ["import", name, str(path), "-o", str(out), *FORMATS[name][1], *options])
    sentence = one_sentence(result)
    assert set(path.parent.rglob("*")) == before, "something was written"
    return sentence


def first_image(name: str, path: Path) -> Path:
    """A file that holds the pixels of the first views."""
    if name == "dicom-ct-pd":
        return min(path.glob("*.dcm"))
    if name == "r2":
        return path / "proj_train" / "0000.npy"
    if name in ("nxtomo", "dxchange", "naf"):
        return path
    return min(path.parent.rglob("*.tif"))


@pytest.fixture
def scan(request, tmp_path):
    if request.param == "dicom-ct-pd":
        pytest.importorskip("pydicom")
    return request.param, FORMATS[request.param][0](tmp_path)


every_format = pytest.mark.parametrize("scan", FORMATS, indirect=True)


@every_format
def test_a_file_that_is_missing(scan, tmp_path):
    name, _ = scan
    assert "nowhere" in said(name, tmp_path / "nowhere")


@every_format
def test_a_foreign_file(scan, tmp_path):
    name, path = scan
    if path.is_dir():
        for file in [p for p in path.rglob("*") if p.is_file()]:
            file.write_bytes(b"\0\1foreign" * 30)
    else:
        path.write_bytes(b"\0\1foreign" * 30)
    assert str(path) in said(name, path)


@every_format
def test_an_empty_file(scan, tmp_path):
    name, path = scan
    for file in [p for p in path.rglob("*") if p.is_file()] if path.is_dir() else [path]:
        file.write_bytes(b"")
    assert str(path) in said(name, path)


@every_format
@pytest.mark.parametrize("part", [0.05, 0.5, 0.9])
def test_images_that_are_cut_off(scan, part):
    name, path = scan
    file = first_image(name, path)
    data = file.read_bytes()
    file.write_bytes(data[: int(part * len(data))])
    assert file.name in said(name, path)


@every_format
def test_images_that_are_missing(scan):
    name, path = scan
    if name in ("nxtomo", "dxchange"):
        with h5py.File(path, "a") as file:
            del file["exchange/data" if name == "dxchange" else "entry0000/instrument/detector/data"]
    elif name == "naf":
        values = pickle.loads(path.read_bytes())
        del values["val"]["projections"]
        path.write_bytes(pickle.dumps(values))
    elif name == "dicom-ct-pd":
        for file in path.glob("*.dcm"):
            file.unlink()
    else:
        file = first_image(name, path)
        file.unlink()
        sentence = said(name, path)
        assert str(path) in sentence or str(file) in sentence
        return
    assert str(path) in said(name, path)


@every_format
def test_images_of_another_size(scan):
    name, path = scan
    file = first_image(name, path)
    small = np.ones((4, 5), np.float32)
    if name in ("nxtomo", "dxchange"):
        place = "exchange/data" if name == "dxchange" else "entry0000/instrument/detector/data"
        with h5py.File(path, "a") as opened:
            del opened[place]
            opened[place] = np.ones((foreign.VIEWS - 1, 4, 5), np.uint16)
    elif name == "naf":
        values = pickle.loads(path.read_bytes())
        values["train"]["projections"] = np.ones((9, 4, 5), np.float32)
        path.write_bytes(pickle.dumps(values))
    elif name == "r2":
        np.save(file, small)
    elif name == "dicom-ct-pd":
        pydicom = pytest.importorskip("pydicom")
        data = pydicom.dcmread(file)
        data.Rows, data.Columns, data.PixelData = 4, 5, b"\1\0" * 20
        data.save_as(file)
    else:
        tifffile.imwrite(file, small)
    assert path.name in said(name, path) or file.name in said(name, path)


KEYS = [
    ("nikon", "SrcToObject", None, "SrcToObject"),
    ("nikon", "AngularStep", None, "AngularStep"),
    ("nikon", "DetectorPixelsX", "99999999999", "DetectorPixelsX"),
    ("nikon", "DetectorPixelsX", "90000", "expected 16 x 90000"),
    ("nikon", "Projections", "1e400", "Projections"),
    ("nikon", "Projections", "13", "Projections is 13"),
    ("nikon", "SrcToDetector", "far", "SrcToDetector must be a number"),
    ("nikon", "DetectorPixelSizeX", "-1", "pitch must be positive"),
    ("fips", "DistanceSourceOrigin", None, "DistanceSourceOrigin"),
    ("fips", "PixelSize", None, "PixelSize"),
    ("fips", "NumberImages", "11", "NumberImages is 11"),
    ("fips", "AngleLast", "100", "do not end at AngleLast"),
    ("fips", "DistanceSourceOrigin", "nan", "DistanceSourceOrigin must be a number"),
    ("bruker", "Object to Source (mm)", None, "Object to Source"),
    ("bruker", "Number of Rows", "100000000", "Number of Rows"),
    ("bruker", "Number of Files", "40", "Number of Files is 40"),
    ("bruker", "Image Pixel Size (um)", "0", "pitch must be positive"),
    ("bruker", "Depth (bits)", "1e9", "Depth (bits) must be 1 to 32"),
]


@pytest.mark.parametrize(("name", "key", "value", "text"), KEYS)
def test_keys_that_are_missing_or_wrong(name, key, value, text, tmp_path):
    path = FORMATS[name][0](tmp_path)
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith(f"{key}=")]
    if value is not None:
        lines.append(f"{key}={value}")
    path.write_text("\n".join(lines), encoding="utf-8")
    assert text in said(name, path)


def change_json(path, change):
    meta = json.loads((path / "meta_data.json").read_text(encoding="utf-8"))
    change(meta)
    (path / "meta_data.json").write_text(json.dumps(meta), encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda m: m["scanner"].pop("DSD"), "DSD"),
        (lambda m: m["scanner"].update(nDetector=[10**9, 10**9]), "expected"),
        (lambda m: m["scanner"].update(nDetector=[-16, 20]), "at least one row"),
        (lambda m: m["proj_train"][0].update(file_path="../../../../etc/passwd"), "there is no file"),
        (lambda m: m["proj_train"][0].pop("angle"), "angle"),
        (lambda m: m.update(proj_train=[]), "lists no views"),
        (lambda m: m["scanner"].update(nVoxel=["a", 2, 3]), "nVoxel"),
    ],
)
def test_folders_of_r2_gaussian_with_wrong_keys(change, text, tmp_path):
    path = foreign.write_r2(tmp_path)
    change_json(path, change)
    assert text in said("r2", path)


def change_scenario(folder, change):
    scenario = json.loads((folder / "ball.json").read_text(encoding="utf-8"))
    change(scenario)
    (folder / "ball.json").write_text(json.dumps(scenario), encoding="utf-8")


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda s: s["file"].update(file_type="CTSimU Metadata"), "no CTSimU Scenario file"),
        (lambda s: s["geometry"].pop("stage"), "stage is missing"),
        (lambda s: s["geometry"]["source"].update(type="fan"), "cone and parallel are read"),
        (lambda s: s["geometry"]["stage"]["center"]["x"].update(unit="furlong"), "the unit 'furlong'"),
        (lambda s: s["geometry"]["stage"]["center"]["x"].update(value="far"), "x must be a number"),
        (lambda s: s["geometry"]["stage"].update(vector_u={a: {"value": 0} for a in "xyz"}), "must be orthogonal"),
        (
            lambda s: s["geometry"]["stage"]["center"]["z"].update(drifts=[{"file": "z.csv"}]),
            "drifts by a file, 'z.csv'",
        ),
        (lambda s: s["geometry"]["stage"]["deviations"][0].update(axis="q"), "an axis is x, y, z"),
        (lambda s: s["geometry"]["stage"]["deviations"][0].update(type="bend"), "translation or rotation"),
        (lambda s: s["geometry"].update(stage=[]), "stage is missing, or no mapping"),
        (lambda s: s["acquisition"].update(number_of_projections=10**12), "number_of_projections must be"),
        (lambda s: s["acquisition"].update(number_of_projections=11), "12 projections, the scenario has 11"),
        (lambda s: s["detector"].update(columns={"value": 10**9}), "expected"),
        (lambda s: s["source"].update(voltage=None), "does not state the spectrum: give --kvp KV"),
        (lambda s: s.update(source=[1]), "a mapping is expected"),
        (lambda s: s["source"].update(spectrum={"monochromatic": False}), None),
    ],
)
def test_scenarios_with_wrong_keys(change, text, tmp_path):
    path = foreign.write_ctsimu(tmp_path)
    change_scenario(tmp_path, change)
    if text is not None:
        assert text in said("ctsimu", path)
    else:
        assert "--filter '2.5 mm Al'" in said("ctsimu", path)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (lambda m: m.pop("output"), "output.projections is missing"),
        (lambda m: m["output"]["projections"].update(filename="../../etc/passwd_%04d.tif"), "leads out of the folder"),
        (lambda m: m["output"]["projections"].update(filename="ball_%s%s.tif"), "is no pattern"),
        (lambda m: m["output"]["projections"].update(number=-1), "need a filename and a number"),
        (lambda m: m["output"]["projections"].update(filename="ball_%04d.raw", datatype="complex"), "one of the types"),
        (lambda m: m["output"]["projections"].update(filename="ball_%04d.raw"), "is no file"),
        (lambda m: m["acquisition_geometry"].update(path_to_CTSimU_JSON="nowhere.json"), "is not there"),
        (lambda m: m["file"].update(file_type="Other"), "no CTSimU Metadata file"),
    ],
)
def test_metadata_of_projections_with_wrong_keys(change, text, tmp_path):
    path = foreign.write_ctsimu(tmp_path)
    metadata = json.loads(path.read_text(encoding="utf-8"))
    change(metadata)
    path.write_text(json.dumps(metadata), encoding="utf-8")
    assert text in said("ctsimu", path)


class _Evil:
    """What a hostile pickle would run."""

    def __reduce__(self):
        return (Path.touch, (Path("/tmp/phantomgen_hostile_pickle_ran"),))


@pytest.mark.parametrize("content", [_Evil(), {"train": _Evil()}, [1, 2], {"train": {"angles": np.ones(3)}}, 7])
def test_nothing_in_a_pickle_is_run(content, tmp_path):
    marker = Path("/tmp/phantomgen_hostile_pickle_ran")
    marker.unlink(missing_ok=True)
    path = tmp_path / "evil.pickle"
    path.write_bytes(pickle.dumps(content))
    assert "evil.pickle" in said("naf", path)
    assert not marker.exists()


def test_arrays_of_objects_are_not_read(tmp_path):
    path = foreign.write_r2(tmp_path)
    np.save(path / "proj_train" / "0000.npy", np.array([_Evil()], dtype=object), allow_pickle=True)
    assert "0000.npy" in said("r2", path)
    assert not Path("/tmp/phantomgen_hostile_pickle_ran").exists()


HDF5 = {"nxtomo": "entry0000/instrument/detector", "dxchange": "exchange"}


@pytest.mark.parametrize("name", HDF5)
def test_a_stack_that_declares_more_than_the_file_holds(name, tmp_path):
    path = FORMATS[name][0](tmp_path)
    with h5py.File(path, "a") as file:
        del file[f"{HDF5[name]}/data"]
        file[HDF5[name]].create_dataset(
            "data", (10**6, 10**5, 10**5), np.uint16, chunks=(1, 64, 64), compression="gzip"
        )
    assert "cut off" in said(name, path)


@pytest.mark.parametrize(
    ("name", "place", "value", "text"),
    [
        ("nxtomo", "entry0000/definition", "NXarpes", "no entry whose definition is NXtomo"),
        ("nxtomo", "entry0000/sample/rotation_angle", None, "rotation_angle is missing"),
        ("nxtomo", "entry0000/sample/rotation_angle", np.ones(3), "3 values for 15 frames"),
        ("nxtomo", "entry0000/sample/rotation_angle", np.full(15, np.nan), "not finite"),
        ("nxtomo", "entry0000/sample/rotation_angle", "turned", "must hold numbers"),
        ("nxtomo", "entry0000/instrument/detector/image_key", np.ones(4), "4 values of image_key"),
        ("nxtomo", "entry0000/sample/x_translation", np.arange(15.0), "only z_translation"),
        ("nxtomo", "entry0000/instrument/detector/x_pixel_size", None, "--pitch MM"),
        ("nxtomo", "entry0000/instrument/detector/x_pixel_size", -1.0, "must be positive"),
        ("dxchange", "exchange/theta", None, "theta is missing"),
        ("dxchange", "exchange/theta", np.ones(5), "5 angles for 12 views"),
        ("dxchange", "exchange/data", np.ones(5), "expected images"),
        ("dxchange", "exchange/data_white", np.ones((1, 3, 3)), "flats have shape"),
        ("dxchange", "measurement/instrument/detector/pixel_size_x", None, "--pitch MM"),
    ],
)
def test_hdf5_files_that_lack_or_misstate_something(name, place, value, text, tmp_path):
    path = FORMATS[name][0](tmp_path)
    with h5py.File(path, "a") as file:
        if place in file:
            del file[place]
        if value is not None:
            file[place] = value
        if place.endswith("image_key"):
            del file["entry0000/instrument/detector/image_key_control"]
    assert text in said(name, path)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("values: counts", "values: photons", "values"),
        ("values: counts", "valeus: counts", "valeus is an unknown key"),
        ('views: "{channel}/view_*.tif"', "", "views is missing"),
        ('"{channel}/view_*.tif"', '"{channel}/nothing_*.tif"', "no TIFF file"),
        ('"{channel}/view_*.tif"', "low/view_*.tif", "{channel}"),
        ("views: 12", "views: 13", "12 images, the geometry 13 views"),
        ("rows: 16", "rows: 17", "expected 17 x 20"),
        ("sod: 200.0", "sod: 999", "0 < sod < sdd"),
        ("kvp: 120", "kvp: minus", "beam.kvp"),
        ("thresholds: [20, 60]", "thresholds: [60, 20]", "ascend"),
        ("values: counts", "values: counts\nexposure: [1, 2]", "2 values for 12 views"),
        ("geometry:", "!!python/object/apply:os.system [id]\ngeometry:", "not YAML"),
    ],
)
def test_yaml_files_with_wrong_keys(old, new, text, tmp_path):
    path = foreign.write_tiff(tmp_path)
    assert old in path.read_text(encoding="utf-8")
    path.write_text(path.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert text in said("tiff", path)


def test_a_tiff_that_declares_more_than_it_holds(tmp_path):
    path = foreign.write_nikon(tmp_path)
    entries = [(256, 4, 1, 100000), (257, 4, 1, 100000), (258, 3, 1, 16), (259, 3, 1, 1), (262, 3, 1, 1),
               (273, 4, 1, 8), (277, 3, 1, 1), (278, 4, 1, 100000), (279, 4, 1, 4)]  # fmt: skip
    body = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    data = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries)) + body + b"\0\0\0\0"
    (tmp_path / "ball_0001.tif").write_bytes(data)
    assert "cut off" in said("nikon", path)


@pytest.mark.parametrize(
    ("tag", "value", "text"),
    [
        (0x70311003, None, "(7031,1003)"),
        (0x70311031, 0.0, "sdd must be positive"),
        (0x70291010, 60000, "not to be believed"),
        (0x7029100B, "SPHERICAL", "DetectorShape is SPHERICAL"),
        (0x70311033, [1.0], "DetectorCentralElement"),
        (0x70291002, 40.0, "differs from"),
    ],
)
def test_dicom_files_that_lack_or_misstate_a_tag(tag, value, text, tmp_path):
    pydicom = pytest.importorskip("pydicom")
    path = foreign.write_dicom(tmp_path)
    file = max(path.glob("*.dcm"))
    data = pydicom.dcmread(file)
    kind = data[tag].VR
    del data[tag]
    if value is not None:
        data.add_new(tag, kind, value)
    data.save_as(file)
    assert text in said("dicom-ct-pd", path)


def test_values_that_are_no_numbers(tmp_path):
    path = foreign.write_r2(tmp_path)
    file = path / "proj_train" / "0002.npy"
    image = np.load(file)
    image[3, 4] = np.nan
    np.save(file, image)
    assert "not a number" in said("r2", path)


def test_counts_handed_in_as_line_integrals(tmp_path):
    path = foreign.write_r2(tmp_path)
    file = path / "proj_train" / "0000.npy"
    np.save(file, np.full((foreign.ROWS, foreign.COLUMNS), -4e4, np.float32))
    assert "are these counts?" in said("r2", path)


def test_an_output_that_exists_is_not_replaced(tmp_path):
    path = foreign.write_bruker(tmp_path)
    (tmp_path / "out.h5").write_text("mine", encoding="utf-8")
    assert "add --overwrite" in said("bruker", path)
    assert (tmp_path / "out.h5").read_text(encoding="utf-8") == "mine"


def test_the_scan_is_not_overwritten_by_its_dataset(tmp_path):
    path = foreign.write_dxchange(tmp_path, "out.h5")
    data = path.read_bytes()
    assert "is the scan itself" in said("dxchange", path, "--overwrite")
    assert path.read_bytes() == data
