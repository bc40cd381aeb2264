"""Scans on curved panels for other programs: kept where the format has them, resampled on demand, refused otherwise."""

import re
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from support.poses import largest_difference
from support.tiny_scans import make, one_sentence

from phantomgen.cli.export import PROGRAMS
from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.conversions.astra import from_astra
from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.geometry.flat_panel import flat_equivalent, on_flat_panel
from phantomgen.importers.rtk_geometry import read_rtk_geometry
from recon.cli.main import main as recon

ORBIT = "geometry={type: helical, sod: 500, sdd: 800, views: 6, pitch: 20, turns: 1, test_views: 0}"
PANEL = "panel={rows: 8, columns: 12, pitch: 20, curvature: {radius: %s, module_columns: 1}, offset: {columns: 5}}"


def export(*arguments):
    return CliRunner().invoke(phantomgen, ["export", *map(str, arguments)])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("curved") / "curved.h5", "--set", ORBIT, "--set", PANEL % 800)


@pytest.mark.parametrize(
    "program", [name for name in PROGRAMS if name not in ("rtk", "dicom-ct-pd", "tiff", "dxchange")]
)
def test_programs_with_flat_panels_refuse_a_curved_one(scan, program, tmp_path):
    said = one_sentence(export(scan, "--to", program, "-o", tmp_path / "out"))
    assert re.search(
        "knows flat panels only, and this one has a radius of 800 mm: resample .* [(]--flat-panel[)]", said
    )
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("command", [["export"], ["decompose", "--bases", "2"]])
def test_line_integrals_are_resampled_on_demand(scan, command, tmp_path):
    program = phantomgen if command[0] == "export" else recon
    arguments = [*command, str(scan), "--to", "astra", "--flat-panel", "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(program, arguments)
    assert result.exit_code == 0, result.output
    with open_dataset(scan) as dataset:
        flat = flat_equivalent(dataset.geometry)
        vectors = np.load(tmp_path / "out/vectors.npy")
        found = from_astra("cone_vec", flat.panel.rows, flat.panel.columns, vectors)
        assert found.panel_center == pytest.approx(flat.panel_center)
        assert found.column_step == pytest.approx(flat.column_step)
        if command[0] == "export":
            images = np.stack([dataset.line_integrals(view) for view in range(len(flat))])
            expected, _ = on_flat_panel(images, dataset.geometry)
            stored = np.load(tmp_path / "out/bin2.npy").transpose(1, 0, 2)
            assert stored == pytest.approx(expected[:, 2], abs=1e-5)


def test_counts_are_not_resampled(scan, tmp_path):
    said = one_sentence(export(scan, "--to", "tiff", "--what", "counts", "--flat-panel", "-o", tmp_path / "out"))
    assert "counts of a curved panel are not resampled to a flat one" in said


def test_rtk_keeps_the_panel(scan, tmp_path):
    assert export(scan, "--to", "rtk", "-o", tmp_path / "out").exit_code == 0
    with open_dataset(scan) as dataset:
        geometry = dataset.geometry
        found = read_rtk_geometry(tmp_path / "out/geometry.xml", replace(geometry.panel, curvature=None))
        assert found.panel == geometry.panel
        assert largest_difference(found, geometry) < 1e-9
        assert largest_difference(flat_modules(found), flat_modules(geometry)) < 1e-9


def test_tiff_says_the_radius(scan, tmp_path):
    assert export(scan, "--to", "tiff", "-o", tmp_path / "out").exit_code == 0
    assert '"curvature_radius": 800.0' in (tmp_path / "out/scan.json").read_text()


def test_dicom_keeps_a_panel_around_the_focal_spot(scan, tmp_path):
    pytest.importorskip("pydicom")
    assert export(scan, "--to", "dicom-ct-pd", "-o", tmp_path / "out").exit_code == 0
    folders = [str(tmp_path / f"out/bin{i}") for i in range(4)]
    stated = ["--kvp", "120", "--filter", "6 mm Al", "--photons", "2e5", "--thresholds", "20,40,60,80"]
    result = CliRunner().invoke(
        phantomgen, ["import", "dicom-ct-pd", *folders, "-o", str(tmp_path / "back.h5"), *stated]
    )
    assert result.exit_code == 0, result.output
    with open_dataset(scan) as old, open_dataset(tmp_path / "back.h5") as new:
        assert new.geometry.panel.curvature.radius == pytest.approx(800, abs=1e-4)
        assert new.geometry.panel.columns == 12
        for name in ("source", "panel_center", "column_step", "row_step"):
            assert getattr(new.geometry, name) == pytest.approx(getattr(old.geometry, name), abs=2e-4)
        for view in range(len(new.geometry)):
            assert new.line_integrals(view) == pytest.approx(old.line_integrals(view), abs=2e-4)


def test_dicom_refuses_another_centre(tmp_path):
    pytest.importorskip("pydicom")
    other = make(tmp_path / "other.h5", "--set", ORBIT, "--set", PANEL % 500)
    said = one_sentence(export(other, "--to", "dicom-ct-pd", "-o", tmp_path / "out"))
    assert "DICOM-CT-PD has panels around the focal spot, and this one has a radius of 500 mm at 800 mm" in said
