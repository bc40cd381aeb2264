"""Folders for other programs: the same numbers under the axes of each, poses that come back, and what is refused."""

import json
import pickle
import runpy
import subprocess
import sys
from pathlib import Path
from unittest.mock import MagicMock

import h5py
import numpy as np
import pytest
import SimpleITK
import tifffile
from click.testing import CliRunner
from support.edited_datasets import edited_dataset
from support.poses import largest_difference
from support.tiny_scans import make, one_sentence

from phantomgen.cli.export import PROGRAMS
from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.adapters.to_projections import to_projections
from phantomgen.dataset.file import DETECTOR
from phantomgen.dataset.layout import put
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.exporters.scans import folder as folders
from phantomgen.exporters.scans.dicom_ct_pd import poses_as_tags
from phantomgen.geometry import orbits
from phantomgen.geometry.conversions.astra import from_astra
from phantomgen.geometry.conversions.tigre import TigreGeometry, from_tigre
from phantomgen.geometry.conversions.tomosipo import from_tomosipo
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.panel_mount import Mount, mounted
from phantomgen.geometry.pose_table import read_poses
from phantomgen.importers.naf import read_naf_geometry
from phantomgen.importers.r2_gaussian import read_r2_geometry
from phantomgen.importers.rtk_geometry import read_rtk_geometry
from recon.cli.main import main as recon
from spectra.errors import GeometryError, InputError

CIRCLE = ("astra", "tomosipo", "tigre", "cil", "rtk", "leap", "r2", "naf", "nxtomo", "tiff")
NEAR = 1e-9  # mm; float64 in all files below


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("scan") / "tiny.h5"
    return make(path, "--views", "5", "--test-views", "2", rows=16, columns=16)


@pytest.fixture(scope="module")
def parallel(tmp_path_factory):
    orbit = "geometry={type: parallel, distance: 150, views: 4, test_views: 1}"
    path = tmp_path_factory.mktemp("parallel") / "parallel.h5"
    return make(path, "--set", orbit, "--set", "source.photons=2.0e+5", rows=8, columns=8)


@pytest.fixture(scope="module")
def helix(tmp_path_factory):
    orbit = "geometry={type: helical, sod: 500, sdd: 800, views: 6, pitch: 20, turns: 1, test_views: 0}"
    return make(tmp_path_factory.mktemp("helix") / "helix.h5", "--set", orbit, rows=8, columns=8)


@pytest.fixture(scope="module")
def written(scan, tmp_path_factory):
    """A folder for every program that can describe a circular scan."""
    place = tmp_path_factory.mktemp("folders")
    for program in CIRCLE:
        result = export(scan, "--to", program, "-o", place / program)
        assert result.exit_code == 0, result.output
    return place


def export(*arguments):
    return CliRunner().invoke(phantomgen, ["export", *map(str, arguments)])


def logs(path, split="train"):
    """Line integrals of a dataset, (view, channel, row, column), and its geometry."""
    with open_dataset(path) as dataset:
        views = dataset.splits[split]
        return np.array([dataset.line_integrals(int(v)) for v in views]), dataset.geometry[views]


def test_the_command_offers_what_there_is():
    assert list(PROGRAMS) == list(folders.PROGRAMS)


@pytest.mark.parametrize("program", CIRCLE)
def test_every_folder_says_what_it_holds(written, program):
    record = json.loads((written / program / "scan.json").read_text())
    assert (record["written_by"], record["to"], record["names"][1]) == ("phantomgen export", program, "bin1")
    assert (record["views"], record["training_views"]) == ((7, 5) if program in ("r2", "naf") else (5, 5))
    assert record["what"] == ("counts" if program == "nxtomo" else "line-integrals")


@pytest.mark.parametrize(
    ("program", "back"),
    [
        ("astra", lambda a: a.transpose(1, 0, 2)),
        ("tomosipo", lambda a: a.transpose(1, 0, 2)),
        ("tigre", lambda a: a[:, ::-1]),
        ("leap", lambda a: a[:, ::-1]),
    ],
)
def test_arrays_have_the_axes_of_the_program(written, scan, program, back):
    images, _ = logs(scan)
    for channel in range(4):
        found = np.load(written / program / f"bin{channel}.npy")
        assert found.dtype == np.float32
        assert np.array_equal(back(found), images[:, channel])


def test_the_poses_in_the_folders_are_those_of_the_scan(written, scan):
    _, geometry = logs(scan)
    panel = geometry.panel
    vectors = np.load(written / "astra/vectors.npy")
    assert largest_difference(from_astra("cone_vec", 16, 16, vectors), geometry) < NEAR
    with np.load(written / "tomosipo/vectors.npz") as stored:
        found = from_tomosipo((16, 16), **stored)
    assert largest_difference(found, geometry) < NEAR
    with np.load(written / "tigre/geometry.npz") as stored:
        fields = dict(stored)
    assert fields["angles"].shape == (5,)
    np.testing.assert_allclose(fields["nVoxel"] * fields["dVoxel"], fields["sVoxel"])
    angles = np.pad(fields["angles"][:, None], ((0, 0), (0, 2)))
    names = ("DSO", "DSD", "offDetector", "rotDetector", "COR")
    tigre = TigreGeometry("cone", (16, 16), tuple(fields["dDetector"]), angles, *(fields[n] for n in names))
    assert largest_difference(from_tigre(tigre), geometry) < NEAR
    assert largest_difference(read_rtk_geometry(written / "rtk/geometry.xml", panel), geometry) < NEAR
    assert largest_difference(read_poses(written / "tiff/poses.csv", panel), geometry) == 0


def test_folders_of_rays_hold_tests_too_and_come_back(written, scan):
    with open_dataset(scan) as dataset:
        views = np.concatenate([dataset.splits["train"], dataset.splits["test"]])
        geometry, grid = dataset.geometry[views], dataset.grid
    for found in (read_r2_geometry(written / "r2/bin2"), read_naf_geometry(written / "naf/bin2.pickle")):
        assert found.train == 5
        assert largest_difference(found.geometry, geometry) < 1e-6
        assert found.grid.shape == grid.shape
        assert found.grid.origin == pytest.approx(grid.origin)


def test_r2_gaussian_has_line_integrals_and_the_true_volume_in_its_own_lengths(written, scan):
    place = written / "r2/bin0"
    meta = json.loads((place / "meta_data.json").read_text())
    assert max(meta["scanner"]["sVoxel"]) == pytest.approx(2.0)
    for split, name in (("train", "proj_train"), ("test", "proj_test")):
        images, geometry = logs(scan, split)
        assert len(meta[name]) == len(images)
        for entry, image, angle in zip(meta[name], images[:, 0], geometry.angles, strict=True):
            assert np.array_equal(np.load(place / entry["file_path"]), image)
            assert np.cos(entry["angle"] - angle) == pytest.approx(1.0)
    truth, volume = read_truth(scan), np.load(place / "vol_gt.npy")
    unit = meta["scanner"]["unit_mm"]
    with open_dataset(scan) as dataset:
        weights = dataset.spectra.basis.evaluate(dataset.spectra.effective_energy[:1])[:, 0]
    wanted = np.einsum("b,bzyx->xyz", weights, truth.volumes) * unit
    np.testing.assert_allclose(volume, wanted, rtol=1e-5)
    # A central ray through the volume, in its own lengths, is the line integral but for the hardening of the beam.
    seen = volume.sum(axis=0)[7:9, 7:9].mean() * meta["scanner"]["sVoxel"][0] / 16
    assert seen == pytest.approx(logs(scan)[0][0, 0, 7:9, 7:9].mean(), rel=0.25)


def test_the_pickle_of_naf_is_in_metres(written, scan):
    content = pickle.loads((written / "naf/bin0.pickle").read_bytes())
    assert np.array_equal(content["train"]["projections"], logs(scan)[0][:, 0])
    assert (content["numTrain"], content["numVal"], content["DSO"]) == (5, 2, pytest.approx(500.0))
    volume = np.load(written / "r2/bin0/vol_gt.npy") / json.loads((written / "r2/scan.json").read_text())["unit_mm"]
    np.testing.assert_allclose(content["image"], volume * 1000, rtol=1e-5)


def test_rtk_reads_projections_around_the_centre_of_the_panel(written, scan):
    image = SimpleITK.ReadImage(str(written / "rtk/bin1.mha"))
    images, geometry = logs(scan)
    assert np.array_equal(SimpleITK.GetArrayFromImage(image)[:, ::-1], images[:, 1])
    pitch = geometry.panel.column_pitch
    assert image.GetOrigin() == pytest.approx((-7.5 * pitch, -7.5 * pitch, 0.0))
    assert image.GetSpacing() == pytest.approx((pitch, pitch, 1.0))


def test_cil_has_one_file_with_all_channels(written, scan):
    with h5py.File(written / "cil/projections.nxs") as file:
        entry = file["entry1/tomo_entry"]
        data = entry["data/data"]
        assert [data.attrs[f"dim{i}"] for i in range(4)] == ["channel", "angle", "vertical", "horizontal"]
        assert data.attrs["panel_origin"] == "top-left"
        assert np.array_equal(data[()], logs(scan)[0].transpose(1, 0, 2, 3))
        assert entry["config/source/position"][()] == pytest.approx([0, -500, 0], abs=1e-4)
        assert entry["config/angles"][:2] == pytest.approx([-90, -90 - 72], abs=1e-4)


def test_nxtomo_reads_counts_flats_and_darks(written, scan):
    nxtomo = pytest.importorskip("nxtomo")
    found = nxtomo.NXtomo().load(str(written / "nxtomo/bin3.nx"), "entry0000")
    keys = [key.value for key in found.instrument.detector.image_key_control]
    assert keys == [1] * 50 + [0] * 5 + [2]
    assert found.instrument.detector.distance.to("mm").magnitude == pytest.approx(300.0)
    assert found.instrument.source.distance.to("mm").magnitude == pytest.approx(-500.0)
    with open_dataset(scan) as dataset, h5py.File(written / "nxtomo/bin3.nx") as file:
        frames = file["entry0000/instrument/detector/data"]
        assert np.array_equal(frames[50:55], dataset.load(dataset.splits["train"])[:, 3])
        assert np.array_equal(frames[:50].mean(axis=0), dataset.flat[3])
        turned = found.sample.rotation_angle.to("radian").magnitude[50:55]
        assert np.exp(-1j * turned) == pytest.approx(np.exp(1j * dataset.geometry.angles[:5]))


def test_tiff_holds_counts_when_asked(scan, tmp_path):
    assert export(scan, "--to", "tiff", "--what", "counts", "--channel", "bin2", "-o", tmp_path / "t").exit_code == 0
    with open_dataset(scan) as dataset:
        counts = dataset.load([1])[0, 2]
    assert np.array_equal(tifffile.imread(tmp_path / "t/bin2/view_0001.tif"), counts)
    assert len(list((tmp_path / "t/bin2").glob("flat_*.tif"))) == 50
    assert np.shape(json.loads((tmp_path / "t/scan.json").read_text())["exposure"]) == (5, 1)


def test_dxchange_holds_a_parallel_scan(parallel, tmp_path):
    assert export(parallel, "--to", "dxchange", "-o", tmp_path / "d").exit_code == 0
    with h5py.File(tmp_path / "d/bin0.h5") as file, open_dataset(parallel) as dataset:
        exchange = {name: file[f"exchange/{name}"][()] for name in ("data", "data_white", "data_dark", "theta")}
        logged = np.log(
            (exchange["data_white"].mean(0) - exchange["data_dark"].mean(0))
            / np.maximum(exchange["data"] - exchange["data_dark"].mean(0), 0.5)
        )
        wanted = [dataset.line_integrals(v)[0] for v in range(4)]
    np.testing.assert_allclose(logged, wanted, atol=1e-4)
    assert exchange["theta"] == pytest.approx([0, -45, -90, -135])


STATED = ("--kvp", "120", "--filter", "none", "--thresholds", "20", "--photons", "2e5", "--test-views", "0")


@pytest.mark.parametrize("source", ["scan", "helix", "tilted"])
def test_a_scenario_of_ctsimu_comes_back(source, request, tmp_path, monkeypatch, capsys):
    if source == "tilted":
        orbit = "geometry={type: laminography, sod: 500, sdd: 800, views: 5, tilt: 30, start: 20, test_views: 0}"
        path = make(tmp_path / "tilted.h5", "--set", orbit, rows=6, columns=8)
    else:
        path = request.getfixturevalue(source)
    assert export(path, "--to", "ctsimu", "--channel", "bin1", "-o", tmp_path / "c").exit_code == 0
    scenario = json.loads((tmp_path / "c/scenario.json").read_text())
    turns = "drifts" not in scenario["geometry"]["source"]["center"]["x"]
    assert turns == (source != "helix")
    if turns:
        assert scenario["acquisition"]["stop_angle"]["value"] == pytest.approx(360)
    arguments = ["import", "ctsimu", tmp_path / "c/bin1_metadata.json", *STATED, "-o", tmp_path / "back.h5"]
    result = CliRunner().invoke(phantomgen, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    with open_dataset(path) as first, open_dataset(tmp_path / "back.h5") as back:
        views = first.splits["train"]
        assert largest_difference(back.geometry, first.geometry[views]) < NEAR
        found = [back.line_integrals(view)[0] for view in range(len(views))]
        wanted = [first.line_integrals(int(view))[1] for view in views]
        np.testing.assert_allclose(found, wanted, atol=1e-5)
    monkeypatch.setattr(sys, "argv", ["load.py"])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(tmp_path / "c/load.py"))
    assert capsys.readouterr().out.startswith(f"counts bin1 ({len(views)}, ")


def test_a_parallel_beam_is_no_scenario_of_ctsimu(parallel, tmp_path):
    said = one_sentence(export(parallel, "--to", "ctsimu", "-o", tmp_path / "c"))
    assert "scenarios of CTSimU are written for cone beams, and this beam is parallel: take tiff" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("program", ["tigre", "cil", "rtk", "r2", "astra", "tiff", "nxtomo"])
def test_a_parallel_scan_goes_where_it_can(parallel, program, tmp_path):
    assert export(parallel, "--to", program, "-o", tmp_path / "p").exit_code == 0


def test_dicom_reads_every_view(scan, tmp_path):
    pydicom = pytest.importorskip("pydicom")
    assert export(scan, "--to", "dicom-ct-pd", "--channel", "bin1", "-o", tmp_path / "d").exit_code == 0
    images, geometry = logs(scan)
    for view, path in enumerate(sorted((tmp_path / "d/bin1").glob("*.dcm"))):
        found = pydicom.dcmread(path)
        values = found.pixel_array * float(found.RescaleSlope) + float(found.RescaleIntercept)
        np.testing.assert_allclose(values, images[view, 1], atol=1e-4)
        phi, z, rho = (found[0x7031, tag].value for tag in (0x1001, 0x1002, 0x1003))
        assert (-rho * np.sin(phi), rho * np.cos(phi), z) == pytest.approx(tuple(geometry.source[view]), abs=1e-3)
        assert found[0x7031, 0x1033].value == [8.5, 8.5]
        assert found[0x7031, 0x1031].value == pytest.approx(800.0)


@pytest.mark.parametrize("program", CIRCLE)
def test_the_script_opens_every_file_of_its_folder(written, program, monkeypatch, tmp_path):
    """Packages that are not installed are replaced by ones that take everything; NumPy and h5py are real."""
    place = written / program
    script = (place / "load.py").read_text().splitlines()
    assert len(script[script.index("scan, name = load()") :]) <= 18
    absent = ("astra", "tomosipo", "tigre", "cil", "itk", "leapctype", "r2_gaussian", "src", "ts_algorithms", "torch")
    for name in absent:
        monkeypatch.setitem(sys.modules, name, MagicMock())
    for name in ("cil.framework", "cil.io", "cil.optimisation.algorithms", "cil.plugins.astra", "cil.recon",
                 "r2_gaussian.dataset.dataset_readers", "src.dataset.tigre"):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, MagicMock())
    monkeypatch.setattr(np, "save", lambda *_: None)
    monkeypatch.setattr(sys, "argv", ["load.py", "bin1"])
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(place / "load.py"))


def test_an_existing_folder_is_kept_unless_it_is_ours(scan, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").write_text("mine")
    assert "exists: choose another name by --out, or add --overwrite" in one_sentence(
        export(scan, "--to", "astra", "-o", tmp_path / "mine")
    )
    assert "is not a folder that phantomgen export wrote; it will not be replaced" in one_sentence(
        export(scan, "--to", "astra", "-o", tmp_path / "mine", "--overwrite")
    )
    assert (tmp_path / "mine/file").read_text() == "mine"
    for _ in range(2):
        assert export(scan, "--to", "leap", "-o", tmp_path / "ours", "--overwrite").exit_code == 0
    assert sorted(p.name for p in tmp_path.iterdir()) == ["mine", "ours"]


@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("r2", "R2-Gaussian's folder can only describe circular scans with a centred upright panel: view"),
        ("naf", "NAF's pickle can only describe circular scans"),
        ("nxtomo", "NXtomo can only describe circular scans"),
        ("dxchange", "can only describe parallel beams, this scan has a cone beam (helical geometry)"),
    ],
)
def test_what_a_program_cannot_say_is_one_sentence_and_leaves_nothing(helix, program, said, tmp_path):
    assert said in one_sentence(export(helix, "--to", program, "-o", tmp_path / "out"))
    assert list(tmp_path.iterdir()) == []


def test_a_helix_goes_to_programs_of_vectors(helix, tmp_path):
    for program in ("astra", "tigre", "rtk", "leap", "cil", "tomosipo"):
        assert export(helix, "--to", program, "-o", tmp_path / program).exit_code == 0
    assert json.loads((tmp_path / "astra/scan.json").read_text())["method"] == "SIRT3D_CUDA"
    assert json.loads((tmp_path / "cil/scan.json").read_text())["flex"] is True


def test_wrong_options_are_one_sentence(scan, tmp_path):
    out = tmp_path / "o"
    assert "has no channel 'bin9': it has bin0, bin1, bin2, bin3" in one_sentence(
        export(scan, "--to", "rtk", "--channel", "bin9", "-o", out)
    )
    assert (
        "a folder for rtk holds line-integrals, not counts; counts go to nxtomo, dxchange, ctsimu, tiff"
        in one_sentence(export(scan, "--to", "rtk", "--what", "counts", "-o", out))
    )
    assert "--what, --channel, --air and --flat-panel need --to" in export(scan, "--what", "counts", "-o", out).output
    assert "does not go with --to" in export(scan, "--labels", "--to", "rtk", "-o", out).output
    assert not out.exists()


def test_blind_pixels_are_interpolated_in_line_integrals(scan, tmp_path):
    path = tmp_path / "blind.h5"
    path.write_bytes(scan.read_bytes())
    with edited_dataset(path) as file:
        mask = np.zeros((16, 16), np.uint32)
        mask[5, 6] = 2
        put(file[f"{DETECTOR}/bin0_channel"], "pixel_mask", mask)
    with open_dataset(path) as dataset:
        image = to_projections(dataset, "line-integrals", ["bin0"]).image(0)[0]
        left, right = dataset.line_integrals(0)[0, 5, [5, 7]]
    assert np.isfinite(image).all()
    assert image[5, 6] == pytest.approx((left + right) / 2, rel=1e-5)


def test_channels_of_different_views_are_refused_together(scan, tmp_path):
    path = tmp_path / "switched.h5"
    path.write_bytes(scan.read_bytes())
    with edited_dataset(path) as file:
        scale = np.ones((7, 4))
        scale[::2, 0] = 0
        del file["entry/exposure/scale"]
        put(file["entry/exposure"], "scale", scale)
    with open_dataset(path) as dataset:
        with pytest.raises(InputError, match=r"channels bin0 and bin1 of .* were measured in different views"):
            to_projections(dataset, "line-integrals")
        alone = to_projections(dataset, "line-integrals", ["bin0"])
        assert np.isfinite(alone.image(0)).all()
    assert (alone.train, len(alone)) == (2, 3)


def test_decomposed_projections_are_written(scan, tmp_path):
    arguments = ["decompose", str(scan), "--to", "leap", "-o", str(tmp_path / "d"), "--threads", "1"]
    result = CliRunner().invoke(recon, arguments)
    assert result.exit_code == 0, result.output
    images = [np.load(tmp_path / f"d/{name}.npy") for name in ("photoelectric", "compton", "kedge_63.3")]
    assert all(image.shape == (5, 16, 16) for image in images)
    truth = read_truth(scan)
    seen = truth.volumes[1].sum(axis=2)[7:9, 7:9].mean() * truth.grid.spacing[2]
    assert images[1][0, 7:9, 7:9].mean() == pytest.approx(seen, rel=0.3)


def xml(tmp_path, written, *changes):
    text = (written / "rtk/geometry.xml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    (tmp_path / "g.xml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_rtk_geometry(tmp_path / "g.xml", Panel(16, 16, 1.0))
    assert str(caught.value).startswith(f"{tmp_path / 'g.xml'}")
    return str(caught.value)


def test_a_broken_geometry_of_rtk_is_one_sentence(written, tmp_path):
    assert "it is not XML" in xml(tmp_path, written, ("<Projection>", "<Projection"))
    assert "version 2, not RTKThreeDCircularGeometry version 3" in xml(
        tmp_path, written, ('version="3"', 'version="2"')
    )
    wrong = ("<GantryAngle>0</GantryAngle>", "<GantryAngle>x</GantryAngle>")
    assert "GantryAngle must be a number, got 'x'" in xml(tmp_path, written, wrong)
    added = "<GantryAngle>0</GantryAngle><RadiusCylindricalDetector>800</RadiusCylindricalDetector>"
    change = ("<GantryAngle>0</GantryAngle>", added)
    assert "RadiusCylindricalDetector must be the same in all views" in xml(tmp_path, written, change)
    moved = "<SourceToIsocenterDistance>400<"
    assert "Matrix of view 0 is not the one" in xml(tmp_path, written, ("<SourceToIsocenterDistance>500<", moved))


def test_a_broken_folder_of_r2_gaussian_is_one_sentence(written, tmp_path):
    for change, said in (
        ({"scanner": None}, "the key scanner is missing"),
        ({"proj_train": [{"file_path": "a"}]}, "proj_train must be a list of views, each with an angle in radians"),
        ({"proj_train": []}, "proj_train lists no views"),
    ):
        meta = json.loads((written / "r2/bin0/meta_data.json").read_text()) | change
        (tmp_path / "meta_data.json").write_text(json.dumps(meta))
        with pytest.raises(InputError, match=said):
            read_r2_geometry(tmp_path)
    with pytest.raises(InputError, match=r"meta_data.json cannot be read: No such file"):
        read_r2_geometry(tmp_path / "none")


def test_nothing_in_a_pickle_is_run(tmp_path):
    class Run:
        def __reduce__(self):
            return (Path.touch, (tmp_path / "ran",))

    (tmp_path / "a.pickle").write_bytes(pickle.dumps({"train": Run()}))
    with pytest.raises(InputError, match="holds more than arrays and numbers, which is not read"):
        read_naf_geometry(tmp_path / "a.pickle")
    assert not (tmp_path / "ran").exists()
    (tmp_path / "b.pickle").write_bytes(b"no pickle")
    with pytest.raises(InputError):
        read_naf_geometry(tmp_path / "b.pickle")
    (tmp_path / "c.pickle").write_bytes(pickle.dumps({"train": {}}))
    with pytest.raises(InputError, match="must be a mapping with train and val, each with angles"):
        read_naf_geometry(tmp_path / "c.pickle")


def test_the_script_of_rtk_runs(scan, written):
    pytest.importorskip("itk", exc_type=ImportError)
    result = subprocess.run(
        [sys.executable, "-W", "ignore", str(written / "rtk/load.py"), "bin1"], check=False, capture_output=True
    )
    assert result.returncode == 0, result.stderr
    volume = np.load(written / "rtk/bin1_volume.npy")
    assert volume.shape == (16, 16, 16)
    truth = read_truth(scan).volumes[1]
    assert np.corrcoef(volume.ravel(), truth.ravel())[0, 1] > 0.6  # five views


def test_dicom_says_helices_and_shifted_panels_and_refuses_tilted_ones():
    panel, angles = Panel(4, 6, (1.5, 0.5)), np.array([0.3, 2.0])
    shifted = mounted(orbits.helical(500.0, 800.0, angles, 30.0, panel), Mount((2.0, -3.0)))
    for view, tags in enumerate(poses_as_tags(shifted)):
        value = {tag: found for tag, (_, found) in tags.items()}
        phi, z, rho = (value[0x7031, tag] for tag in (0x1001, 0x1002, 0x1003))
        assert (-rho * np.sin(phi), rho * np.cos(phi), z) == pytest.approx(tuple(shifted.source[view]))
        assert value[0x7031, 0x1031] == pytest.approx(800.0)
        assert value[0x7031, 0x1033] == pytest.approx([3.5 - 2.0 / 0.5, 2.5 + 3.0 / 1.5])
        assert value[0x7037, 0x1009] == "HELICAL"
    tilted = mounted(shifted, Mount(tilt=(0.0, 0.1, 0.0)))
    with pytest.raises(GeometryError, match="upright panels across the ray from the source to the axis: that of view"):
        poses_as_tags(tilted)
