"""Inputs that once ended in a traceback, a hang or a page of text are computed, or refused in one short sentence."""

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main as phantomgen
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.volume_files.arrays import read_npy
from recon.cli.main import main as recon
from spectra.errors import InputError

LONG = "q" * 20_000

TETRAHEDRON = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 4
property list uchar int vertex_indices
end_header
0 0 0
10 0 0
0 10 0
0 0 10
3 0 2 1
3 0 1 3
3 1 2 3
3 0 3 99
"""


@pytest.fixture
def _in_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def _links(tmp_path, _in_folder):
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")


def made(*overrides):
    options = [word for override in overrides for word in ("--set", override)]
    panel = "panel={rows: 8, columns: 8, pitch: 20}"
    return CliRunner().invoke(
        phantomgen,
        [
            "make",
            "kedge-small",
            "-q",
            "-o",
            "x.h5",
            "--voxels",
            "8",
            "--set",
            "geometry.views=3",
            "--set",
            panel,
            *options,
        ],
    )


def solid(text):
    return f"objects=[{{material: soft_tissue, {text}}}]"


@pytest.mark.parametrize(
    "override",
    [
        solid("type: tube, radius: 20, inner_radius: 19.999999999, length: 30"),
        solid("type: difference, base: {type: sphere, radius: 20}, cut: [{type: sphere, radius: 19.999999999}]"),
        solid("type: difference, base: {type: sphere, radius: 20}, cut: [{type: sphere, radius: 21}]"),
        solid("type: box, size: [1.0e-9, 20, 20]"),
        "effects.blur.fwhm=1e-300",
        "effects.blur={mtf: 0.25, frequency: 1.0e+300}",
        f"name={LONG}",
    ],
)
@pytest.mark.usefixtures("_in_folder")
def test_what_is_thin_or_narrow_is_computed(override):
    result = made(override)
    assert result.exit_code == 0, result.output
    with h5py.File("x.h5") as file:
        counts = file["entry/instrument/detector/data"][:]
    assert np.isfinite(counts).all()
    assert (counts > 0).any()


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("geometry.sdd=1e9", "less than or equal to"),
        ("effects.blur.fwhm=1e300", "less than or equal to 1000"),
        ("effects.blur={mtf: 0.25, frequency: 1.0e-300}", "at most 10000 pixels"),
        ("effects.focal_spot.width=1e300", "at most 50 mm"),
        ("source.photons=1e300", "expected counts must lie in"),
        (solid("type: sphere, radius: 1.0e+300"), "positive and finite"),
        (solid("type: sphere, radius: 20, center: [1.0e+300, 0, 0]"), "behind the source"),
        (solid("type: mesh, file: bad.ply, unit: mm"), "indices of corners must lie in 0 to 3, got 0 to 99"),
        (f"geometry.type={LONG}", "unknown type"),
        (solid(f"type: sphere, radius: {LONG}"), "valid number"),
        (f"{LONG}=1", "unknown key"),
    ],
)
def test_scenes_that_cannot_be_are_one_short_sentence(tmp_path, monkeypatch, override, words):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.ply").write_text(TETRAHEDRON)
    sentence = one_sentence(made(override))
    assert words in sentence
    assert len(sentence) < 1000
    assert not (tmp_path / "x.h5").exists()


@pytest.mark.parametrize(
    ("program", "arguments", "code"),
    [
        (phantomgen, (LONG,), 2),
        (phantomgen, ("materials", LONG), 1),
        (phantomgen, ("materials", "a b " * 5000), 1),
        (phantomgen, ("materials", "H99999999999999999999"), 1),
        (phantomgen, ("presets", "show", LONG), 1),
        (phantomgen, ("export", "scan.h5", "--to", LONG), 2),
        (phantomgen, ("make", "kedge-small", "--tol", LONG), 2),
        (phantomgen, ("make", "kedge-small", "-o", "n" * 256 + ".h5"), 1),
        (phantomgen, ("make", "kedge-small", "-o", ""), 1),
        (phantomgen, ("make", "a"), 1),
        (phantomgen, ("validate", "a"), 1),
        (phantomgen, ("make", "kedge-small", "-o", "a/x.h5"), 1),
        (recon, ("compare", "scan.h5", "--methods", LONG), 1),
        (recon, ("compare", "scan.h5", "--methods", "fdk", "-o", "n" * 256), 1),
        (recon, ("fit", "scan.h5", "-o", "n" * 256), 1),
        (recon, ("fit", "scan.h5", "-o", "/"), 1),
        (recon, ("fit", "scan.h5", "-o", "/", "--overwrite"), 1),
        (recon, ("fit", "scan.h5", "-o", ""), 1),
        (recon, ("edge", "scan.h5", "-o", ""), 1),
        (recon, ("fit", "a"), 1),
        (recon, ("report", "a"), 1),
    ],
)
@pytest.mark.usefixtures("_links")
def test_commands_that_cannot_be_are_one_short_sentence(tmp_path, program, arguments, code):
    if "scan.h5" in arguments:
        make(tmp_path / "scan.h5", "--views", "3", voxels=4, rows=4, columns=4)
    (tmp_path / "run").mkdir()
    before = sorted(tmp_path.iterdir())
    result = CliRunner().invoke(program, arguments)
    assert result.exit_code == code, result.output
    assert "Error: " in result.stderr
    assert len(result.stderr) < 4500
    assert sorted(tmp_path.iterdir()) == before


def test_a_numpy_file_whose_header_does_not_end_is_one_sentence(tmp_path):
    path = tmp_path / "map.npy"
    np.save(path, np.zeros((4, 4, 4), np.uint8))
    path.write_bytes(path.read_bytes().replace(b"an_order", b"        ").replace(b"}", b" "))
    with pytest.raises(InputError, match="header is damaged"):
        read_npy(path)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (((4, 4), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), "three numbers"),
        (((4, 4, 4), (1.0, 1.0), (0.0, 0.0, 0.0)), "three numbers"),
        (((4, 4, 2.5), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), "whole numbers"),
        (((4, 4, float("inf")), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), "whole numbers"),
    ],
)
@pytest.mark.wrong_types
def test_a_grid_of_a_damaged_run_is_refused(values, words):
    with pytest.raises(InputError, match=words):
        Grid(*values)
