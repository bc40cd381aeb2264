"""Scans of others become datasets: values, poses and facts, against closed forms and files that others wrote."""

from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.geometry.curved_panel import module_frames, ray_directions
from recon.cli.main import main as recon
from tests.support import foreign_scans as foreign
from tests.support.foreign_scans import FORMATS
from tests.support.tiny_scans import make, one_sentence


def run(*arguments):
    return CliRunner().invoke(phantomgen, ["import", *map(str, arguments)])


def imported(name: str, path: Path, out: Path, *options: str):
    if name == "dicom-ct-pd":
        pytest.importorskip("pydicom")
    result = run(name, path, "-o", out, *FORMATS[name][1], *options)
    assert result.exit_code == 0, result.output
    return open_dataset(out)


def written(name: str, folder: Path) -> Path:
    if name == "dicom-ct-pd":
        pytest.importorskip("pydicom")
    return FORMATS[name][0](folder)


def closed_form(geometry, views) -> np.ndarray:
    """Line integrals of the ball along the rays of a dataset's own geometry."""
    columns, rows = np.arange(float(geometry.panel.columns)), np.arange(float(geometry.panel.rows))
    images, sources = [], module_frames(geometry)[views, 0, 0]
    for source, direction in zip(sources, ray_directions(geometry, columns, rows)[views], strict=True):
        images.append(foreign.chord(source + direction, direction))  # a far source would lose digits
    return np.stack(images)


@pytest.mark.parametrize("name", FORMATS)
def test_every_ray_sees_the_ball_where_it_is(name, tmp_path):
    path = written(name, tmp_path)
    with imported(name, path, tmp_path / "out.h5") as dataset:
        found = np.stack([dataset.line_integrals(view)[0] for view in range(len(dataset.geometry))])
        expected = closed_form(dataset.geometry, slice(None))
        assert expected.max() > 0.3
        # Counts of 4e4 are rounded to 1; modules of a curved detector lie within 0.01 pixels of their places.
        tolerance = 2e-4 if name != "dicom-ct-pd" else 6e-3
        assert np.abs(found - expected).max() < tolerance
        assert np.sqrt(np.mean((found - expected) ** 2)) < tolerance / 6
        assert validate(tmp_path / "out.h5") == []


@pytest.mark.parametrize("name", FORMATS)
def test_an_imported_scan_is_reconstructed(name, tmp_path):
    path = written(name, tmp_path)
    imported(name, path, tmp_path / "out.h5", "--voxels", "14", "--size", "35").close()
    result = CliRunner().invoke(
        recon, ["fit", str(tmp_path / "out.h5"), "--method", "cgls", "-o", str(tmp_path / "run")]
    )
    assert result.exit_code == 0, result.output
    with h5py.File(tmp_path / "run" / "volumes.h5") as file:
        total = file["basis/data"][()].sum(axis=0)
        origin, spacing = file["grid/origin"][()], file["grid/spacing"][()]
    middle = origin + spacing * np.array([(total * i).sum() for i in np.indices(total.shape)]) / total.sum()
    assert np.abs(middle[::-1] - foreign.CENTER).max() < 1.0  # mm, of voxels of 2.5 mm


@pytest.mark.slow
def test_one_channel_is_fitted_with_gaussians_as_an_amount_of_water(tmp_path):
    path = written("nxtomo", tmp_path)
    with imported("nxtomo", path, tmp_path / "out.h5", "--voxels", "10") as dataset:
        assert dataset.spectra.basis.names == ("water",)
    result = CliRunner().invoke(recon, ["fit", str(tmp_path / "out.h5"), "-o", str(tmp_path / "run")])
    assert result.exit_code == 0, result.output


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scan")
    views = ("--set", "geometry.views=9", "--set", "geometry.test_views=3")
    return make(folder / "scan.h5", *views, rows=12, columns=12)


STATED = ("--kvp", "140", "--filter", "2.5 mm Al", "--thresholds", "20,45,63.3,80")


@pytest.mark.parametrize("program", ["nxtomo", "r2", "naf", "dicom-ct-pd", "tiff"])
def test_what_we_export_comes_back(program, scan, tmp_path):
    if program == "dicom-ct-pd":
        pytest.importorskip("pydicom")
    folder = tmp_path / program
    what = ("--what", "counts") if program == "tiff" else ()
    exported = CliRunner().invoke(phantomgen, ["export", str(scan), "--to", program, "-o", str(folder), *what])
    assert exported.exit_code == 0, exported.output
    suffix = {"nxtomo": ".nx", "naf": ".pickle"}.get(program, "")
    paths = [folder / f"bin{i}{suffix}" for i in range(4)]
    if program == "tiff":
        paths = [folder / "scan.yaml"]
        paths[0].write_text(
            "geometry: {type: poses, file: poses.csv}\npanel: {rows: 12, columns: 12, pitch: 17.066666666666666}\n"
            'values: counts\nchannels: [bin0, bin1, bin2, bin3]\nviews: "{channel}/view_*.tif"\n'
            'flats: "{channel}/flat_*.tif"\ndarks: "{channel}/dark_*.tif"\n',
            encoding="utf-8",
        )
    photons = () if program in ("nxtomo", "tiff") else ("--photons", "200000")
    result = run(program, *paths, "-o", tmp_path / "back.h5", *STATED, *photons)
    assert result.exit_code == 0, result.output
    with open_dataset(scan) as old, open_dataset(tmp_path / "back.h5") as new:
        views = len(new.geometry)
        for view in range(views):
            # DICOM stores 16 bits of the range of an image, and poses in single precision.
            apart = np.abs(new.line_integrals(view) - old.line_integrals(view)).max()
            assert apart < (2e-4 if program == "dicom-ct-pd" else 1e-6)
        for name in ("source", "panel_center", "column_step", "row_step"):
            assert np.abs(getattr(new.geometry, name) - getattr(old.geometry, name)[:views]).max() < 1e-4
        if program in ("r2", "naf"):
            assert (len(new.splits["train"]), len(new.splits["test"])) == (9, 3)
            assert new.grid == old.grid
        if program == "nxtomo":
            assert new.counts.dtype == np.int32
            np.testing.assert_array_equal(new.counts[()], old.counts[()][:views])


def test_our_own_dataset_is_read_as_nxtomo(scan, tmp_path):
    result = run("nxtomo", scan, "-o", tmp_path / "back.h5", *STATED, "--sod", "500", "--sdd", "800")
    assert result.exit_code == 0, result.output
    with open_dataset(scan) as old, open_dataset(tmp_path / "back.h5") as new:
        np.testing.assert_array_equal(new.counts[()], old.counts[()])
        assert new.spectra.channels == old.spectra.channels
        np.testing.assert_allclose(new.geometry.source, old.geometry.source, atol=1e-9)


def test_readings_become_signals_of_the_stated_photons(tmp_path):
    path = written("bruker", tmp_path)
    with imported("bruker", path, tmp_path / "out.h5") as dataset:
        spectra = dataset.spectra
        assert spectra.units == "keV"
        assert spectra.source.sum() == pytest.approx(2e4)
        np.testing.assert_allclose(
            dataset.flat, spectra.weights.sum(axis=1)[:, None, None] * np.ones_like(dataset.flat)
        )


def test_pixels_are_summed_and_views_left_out(tmp_path):
    path = written("dxchange", tmp_path)
    out = [tmp_path / "whole.h5", tmp_path / "part.h5"]
    with (
        imported("dxchange", path, out[0]) as whole,
        imported("dxchange", path, out[1], "--bin", "2", "--every", "3", "--test-views", "1") as part,
    ):
        assert part.counts.shape == (4, 1, 8, 10)
        blocks = whole.counts[::3].reshape(4, 1, 8, 2, 10, 2).sum(axis=(3, 5))
        np.testing.assert_array_equal(part.counts[()], blocks)
        assert part.geometry.panel.pitch == (5.0, 5.0)
        assert sorted([*part.splits["train"], *part.splits["test"]]) == [0, 1, 2, 3]
        assert len(part.splits["test"]) == 1
        assert part.spectra.source.sum() == pytest.approx(4 * whole.spectra.source.sum())


def test_a_region_of_air_gives_the_output_of_the_tube_in_each_view(tmp_path):
    path = written("fips", tmp_path)
    for i in range(foreign.VIEWS):
        file = tmp_path / f"pine_{i + 1:04d}.tif"
        tifffile.imwrite(file, tifffile.imread(file).astype(np.float32) * (1 + 0.02 * i))
    options = ("--energy", "60", "--photons", "2e4", "--air", "0:16,0:2")
    result = run("fips", path, "-o", tmp_path / "out.h5", *options)
    assert result.exit_code == 0, result.output
    with open_dataset(tmp_path / "out.h5") as dataset:
        expected = 1 + 0.02 * np.arange(foreign.VIEWS)
        np.testing.assert_allclose(dataset.exposure[:, 0], expected / expected.mean(), rtol=1e-5)
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


def test_pixels_without_signal_are_masked(tmp_path):
    path = written("dxchange", tmp_path)
    with h5py.File(path, "a") as file:
        for name in ("data", "data_white", "data_dark"):
            file[f"exchange/{name}"][:, 3, 4] = 7
    with imported("dxchange", path, tmp_path / "out.h5") as dataset:
        assert list(map(tuple, np.argwhere(dataset.mask))) == [(0, 3, 4)]


def test_counters_above_thresholds_become_counts_between_them(tmp_path):
    paths = [foreign.write_dxchange(tmp_path, name) for name in ("total.h5", "high.h5")]
    with h5py.File(paths[1], "a") as file:
        for name in ("data", "data_white", "data_dark"):
            file[f"exchange/{name}"][:] = file[f"exchange/{name}"][()] // 4
    stated = ("--kvp", "100", "--filter", "none", "--thresholds", "20,50")
    result = run("dxchange", *paths, "-o", tmp_path / "out.h5", "--cumulative", *stated)
    assert result.exit_code == 0, result.output
    with open_dataset(tmp_path / "out.h5") as dataset, h5py.File(paths[0]) as total, h5py.File(paths[1]) as high:
        a, b = (np.array(file["exchange/data"], np.int64) for file in (total, high))
        np.testing.assert_array_equal(dataset.counts[:, 0], a - b)
        np.testing.assert_array_equal(dataset.counts[:, 1], b)


def test_nxtomo_with_z_translation_is_a_helix(tmp_path):
    path = foreign.write_nxtomo(tmp_path, lift=6.0)
    with imported("nxtomo", path, tmp_path / "out.h5") as dataset:
        assert dataset.geometry.kind == "helical"
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


def test_nxtomo_with_an_axis_of_channels(tmp_path):
    path = foreign.write_nxtomo(tmp_path)
    with h5py.File(path, "a") as file:
        place = "entry0000/instrument/detector/data"
        frames = file[place][()]
        del file[place]
        file[place] = np.stack([frames, frames // 2], axis=1)
    result = run("nxtomo", path, "-o", tmp_path / "out.h5", "--kvp", "100", "--filter", "none", "--thresholds", "20,50")
    assert result.exit_code == 0, result.output
    with open_dataset(tmp_path / "out.h5") as dataset:
        assert dataset.counts.shape == (foreign.VIEWS, 2, foreign.ROWS, foreign.COLUMNS)


def test_nikon_axis_beside_the_central_ray(tmp_path):
    """CIL: the axis stands at x = -offset; the sample turns about it, source and panel stay."""
    path = foreign.write_nikon(tmp_path, keys="ObjectOffsetX=1.5")
    t = np.deg2rad(-10 + 180)
    x, y, z = foreign.CENTER
    ball = np.array([np.cos(t) * x - np.sin(t) * y - 1.5, np.sin(t) * x + np.cos(t) * y, z])
    with imported("nikon", path, tmp_path / "out.h5") as dataset:
        source, first, column, row = dataset.geometry.ray_frames()[0]
        normal = dataset.geometry.normals()[0]
        ray = foreign.CENTER - source
        point = ray * ((first @ normal) / (ray @ normal)) - first
        found = point @ column / foreign.PITCH**2, point @ row / foreign.PITCH**2
    scale = foreign.SDD / (foreign.SOD + ball[1])
    # Columns are stored from right to left and turned round as they are read.
    expected = (
        ball[0] * scale / foreign.PITCH + (foreign.COLUMNS - 1) / 2,
        (foreign.ROWS - 1) / 2 - z * scale / foreign.PITCH,
    )
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("key", ["ObjectRoll=2", "ObjectTilt=2"])
def test_nikon_axis_that_leans_keeps_the_panel_flat(key, tmp_path):
    path = foreign.write_nikon(tmp_path, keys=key)
    with imported("nikon", path, tmp_path / "out.h5") as dataset:
        geometry = dataset.geometry
        np.testing.assert_allclose(np.linalg.norm(geometry.source, axis=1), foreign.SOD)
        np.testing.assert_allclose(np.linalg.norm(geometry.panel_center - geometry.source, axis=1), foreign.SDD)
        leaning = np.rad2deg(np.arccos(np.abs(geometry.row_step[0, 2]) / foreign.PITCH))
        assert leaning == pytest.approx(2.0, abs=1e-6)


def test_a_nikon_raw_file_holds_all_views(tmp_path):
    path = foreign.write_nikon(tmp_path)
    files = sorted(tmp_path.glob("ball_*.tif"))
    np.concatenate([tifffile.imread(file).ravel() for file in files]).astype("<u2").tofile(tmp_path / "ball.raw")
    with imported("nikon", path, tmp_path / "tiff.h5") as one:
        for file in files:
            file.unlink()
        with imported("nikon", path, tmp_path / "raw.h5") as other:
            np.testing.assert_array_equal(one.counts[()], other.counts[()])


def test_one_radiogram_of_a_body_of_revolution_stands_for_all_views(tmp_path):
    path = foreign.write_nikon(tmp_path)
    for file in sorted(tmp_path.glob("ball_*.tif"))[1:]:
        file.unlink()
    with imported("nikon", path, tmp_path / "out.h5") as dataset:
        assert dataset.counts.shape[0] == foreign.VIEWS
        assert (dataset.counts[()] == dataset.counts[0]).all()


def test_bruker_tables_turn_both_ways(tmp_path):
    path = foreign.write_bruker(tmp_path, "CW")
    with imported("bruker", path, tmp_path / "out.h5") as dataset:
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


def test_mirror_flip_and_reverse_undo_each_other_order(tmp_path):
    path = foreign.write_fips(tmp_path)
    for i, turn in enumerate(reversed(range(foreign.VIEWS))):
        image = foreign.readings(foreign.view((turn + 1) * 360 / foreign.VIEWS))
        tifffile.imwrite(tmp_path / f"pine_{i + 1:04d}.tif", image[::-1, ::-1])
    with imported("fips", path, tmp_path / "out.h5", "--mirror", "--flip-rows", "--reverse") as dataset:
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


def test_the_axis_may_be_projected_beside_the_middle(tmp_path):
    path = foreign.write_fips(tmp_path)
    for i in range(foreign.VIEWS):
        image = foreign.view(i * 360 / foreign.VIEWS, panel_u=1.25 * foreign.PITCH)
        tifffile.imwrite(tmp_path / f"pine_{i + 1:04d}.tif", foreign.readings(image))
    column = (foreign.COLUMNS - 1) / 2 - 1.25
    with imported("fips", path, tmp_path / "out.h5", "--axis-column", str(column)) as dataset:
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


@pytest.mark.parametrize("transposed", [False, True])
def test_a_flat_dicom_panel_is_taken_as_it_is(transposed, tmp_path):
    pytest.importorskip("pydicom")
    path = foreign.write_dicom(tmp_path, "FLAT", transposed)
    with imported("dicom-ct-pd", path, tmp_path / "out.h5") as dataset:
        found = np.stack([dataset.line_integrals(view)[0] for view in range(foreign.VIEWS)])
        assert dataset.geometry.kind == "helical"
        assert np.abs(found - closed_form(dataset.geometry, slice(None))).max() < 2e-4


def test_photons_of_dicom_are_those_of_the_file_unless_stated(tmp_path):
    pytest.importorskip("pydicom")
    path = foreign.write_dicom(tmp_path)
    result = run("dicom-ct-pd", path, "-o", tmp_path / "out.h5", "--filter", "6 mm Al")
    assert result.exit_code == 0, result.output
    assert "PhotonStatistics, 90000" in result.output
    with open_dataset(tmp_path / "out.h5") as dataset:
        assert dataset.spectra.source.sum() == pytest.approx(9e4, rel=0.02)


def test_info_says_what_was_taken_to_be_so(tmp_path):
    path = written("nikon", tmp_path)
    imported("nikon", path, tmp_path / "out.h5").close()
    result = CliRunner().invoke(phantomgen, ["info", str(tmp_path / "out.h5")])
    assert "imported   the panel was taken as a CsI scintillator" in result.output
    with h5py.File(tmp_path / "out.h5") as file:
        assert file["entry/start_time"][()] == file["entry/process_1_import/date"][()]


@pytest.mark.parametrize(
    ("name", "options", "asked"),
    [
        ("nikon", ("--filter", "none"), ["--photons N"]),
        ("fips", (), ["--photons N", "--white LEVEL or --air ROWS,COLUMNS"]),
        ("nxtomo", (), ["--kvp KV, --energy KEV or --spectrum FILE", "--thresholds KEV"]),
        ("dxchange", ("--kvp", "100"), ["--filter '2.5 mm Al'", "--thresholds KEV"]),
        ("r2", ("--kvp", "100", "--filter", "none"), ["--thresholds KEV", "--photons N"]),
        ("tiff", ("--scintillator", "CsI", "--photons", "1e4"), ["the scan has 2 channels"]),
        ("nikon", ("--photons", "1e4", "--basis", "photoelectric,compton"), ["1 channel can tell at most 1"]),
        ("nikon", ("--photons", "1e4", "--bin", "3"), ["cannot be binned by 3"]),
        ("nikon", ("--photons", "1e4", "--filter", "Al"), ["write thickness, unit and material"]),
        ("nikon", ("--photons", "1e4", "--basis", "unobtainium"), ["unobtainium"]),
        ("nikon", ("--photons", "1e4", "--air", "0:99,0:2"), ["reaches beyond the panel"]),
        ("nikon", ("--photons", "1e4", "--sod", "500"), ["0 < sod < sdd"]),
        ("nikon", ("--photons", "-1"), ["--photons must be a positive number"]),
        ("nikon", ("--photons", "1e4", "--test-views", "12"), ["leave none to reconstruct from"]),
    ],
)
def test_what_is_missing_or_wrong_is_asked_for_in_one_sentence(name, options, asked, tmp_path):
    path = FORMATS[name][0](tmp_path)
    said = one_sentence(run(name, path, "-o", tmp_path / "out.h5", *options))
    for text in asked:
        assert text in said
    assert not list(tmp_path.glob("out.h5*"))
