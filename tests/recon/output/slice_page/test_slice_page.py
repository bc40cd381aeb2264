"""Pages of slices: the values that they embed, and what their program shows of them, run in Node."""

import base64
import gzip
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.toy_run import GRID, content

import recon.output.slice_page.page as module
from phantomgen.geometry.voxel_grid import Grid
from recon.output.slice_page.page import LEVELS, SliceContent, embedded, slice_page, stored
from recon.readouts.readouts import Readouts
from spectra.basis.basis import Basis, BasisFunction

BASIS = Basis(
    (BasisFunction("photoelectric"), BasisFunction("compton"), BasisFunction("element", element="Gd", name="kedge_Gd"))
)
ENERGIES = np.arange(20.0, 121.0)
PROGRAM = Path(module.__file__).parent / "slices.js"
RUNNER = Path(__file__).parents[3] / "support" / "run_page.js"
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")


@pytest.fixture(scope="module")
def shown() -> SliceContent:
    toy = content()
    readouts = Readouts.of(BASIS, ENERGIES, np.ones(len(ENERGIES)))
    volumes = {"result": toy.result.astype(float), "truth": toy.true.astype(float)}
    return SliceContent("toy run", GRID, BASIS.names, volumes, readouts)


def unpacked(entry: dict) -> np.ndarray:
    numbers = np.frombuffer(gzip.decompress(base64.b64decode(entry["data"])), "<u2")
    return entry["offset"] + entry["step"] * numbers.astype(np.float64)


@given(arrays(np.float64, (3, 4, 5), elements=st.floats(-1e3, 1e3)))
def test_stored_values_are_those_of_the_volume_within_half_a_step(volume):
    found = unpacked(stored(volume))
    spread = volume.max() - volume.min()
    assert np.abs(found - volume.ravel()).max() <= 0.5001 * spread / LEVELS + 1e-9


def test_a_page_is_one_file_that_names_no_other(shown):
    page = slice_page(shown)
    assert "http" not in page.replace("https://", "http://").replace("http://www.w3.org", "")
    assert "src=" not in page
    assert "toy run" in page


def test_large_volumes_become_means_of_blocks(shown, monkeypatch):
    monkeypatch.setattr(module, "LARGEST", 2 * 3 * 8**3)
    few, factor = shown.binned()
    assert (factor, few.grid.shape) == (2, (8, 8, 8))
    blocks = shown.volumes["result"].reshape(3, 8, 2, 8, 2, 8, 2).mean(axis=(2, 4, 6))
    assert few.volumes["result"] == pytest.approx(blocks)
    corners = [np.array(g.origin) - np.array(g.spacing) / 2 for g in (few.grid, shown.grid)]
    assert corners[0] == pytest.approx(corners[1])
    assert "means of 2 x 2 x 2 voxels" in slice_page(shown)


def run_page(shown: SliceContent, folder: Path, *steps: list) -> dict:
    page = folder / "page.html"
    page.write_text(slice_page(shown), encoding="utf-8")
    command = ["node", RUNNER, page, PROGRAM, json.dumps(steps)]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def picture(found: dict, caption: str) -> np.ndarray:
    (panel,) = [panel for panel in found["panels"] if panel["caption"] == caption]
    return np.array(panel["data"]).reshape(panel["height"], panel["width"], 4)[:, :, 0]


@needs_node
def test_slices_show_the_voxels_of_each_plane_on_the_scale_of_the_truth(shown, tmp_path):
    found = run_page(shown, tmp_path, ["choose", 1])
    assert found["choices"] == ["photoelectric", "Compton", "K-edge Gd", "image at one energy"]
    assert found["unpacked"]
    assert found["energyHidden"]
    truth = shown.volumes["truth"][1]
    volume, window = shown.volumes["result"][1], truth.max() - truth.min()
    sections = {"axial": volume[8], "coronal": volume[:, 8], "sagittal": volume[:, :, 8]}
    for plane, values in sections.items():
        expected = np.clip(255 * ((values[::-1] - truth.max()) / window + 1), 0, 255)
        assert np.abs(picture(found, f"result, {plane}") - expected).max() <= 1


@needs_node
def test_images_at_one_energy_are_those_of_the_readouts(shown, tmp_path):
    index = 30
    found = run_page(shown, tmp_path, ["choose", 3], ["energy", index], ["preset", 0])
    assert (found["energy"], float(found["window"]), float(found["level"])) == ("50 keV", 400, 40)
    values = shown.readouts.hounsfield(shown.volumes["result"], 50.0)
    expected = np.clip(255 * ((values[8, ::-1] - 40) / 400 + 0.5), 0, 255)
    assert np.abs(picture(found, "result, axial") - expected).max() <= 1
    at = values[8, 8, 8]
    assert float(found["values"].split("result ")[1].split()[0]) == pytest.approx(at, rel=6e-3, abs=0.06)


@needs_node
def test_the_cross_hair_moves_by_keys_wheel_and_clicks_and_tells_the_values(shown, tmp_path):
    found = run_page(shown, tmp_path, ["choose", 2], ["click", 0, 0.7, 0.5], ["wheel", 0, 1], ["key", "ArrowDown"])
    z, y, x = 7, 7, 11  # 0.7 of 16 to the right; half of 16 up, and one down; one slice down
    place = [axis[i] for axis, i in zip((GRID.axis(name) for name in "xyz"), (x, y, z), strict=True)]
    assert found["values"].startswith("x {:.1f}, y {:.1f}, z {:.1f} mm: ".format(*place))
    told = shown.volumes["result"][2, z, y, x], shown.volumes["truth"][2, z, y, x]
    for name, value in zip(("result", "truth"), told, strict=True):
        assert float(found["values"].split(f"{name} ")[1].split()[0]) == pytest.approx(value, rel=6e-3)
    amount = float(found["values"].split("Gd in result ")[1].split()[0])
    coefficients = shown.volumes["result"][:, z, y, x]
    assert amount == pytest.approx(float(shown.readouts.concentration(coefficients, "Gd")), rel=6e-3)


def test_energies_lie_within_the_detected_spectrum(shown):
    data = embedded(shown)
    assert (data["energies"][0], data["energies"][-1]) == (20.0, 120.0)
    assert data["energies"][data["start"]] == 70.0
    assert np.array(data["curves"]).shape == (3, len(data["energies"]))
    assert isinstance(shown.grid, Grid)
