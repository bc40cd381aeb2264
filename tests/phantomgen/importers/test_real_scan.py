"""Scans that others made: a real radiogram by a Nikon scanner, and projections of CTSimU by another simulator.

Optional: the first runs where axitom is installed (``pip install axitom``), the others where there are examples.
"""

import json
import os
from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
import trimesh
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main as recon
from spectra.materials.material import Material

VOXEL = 0.0136  # mm, of the other software, by settings.xtekct


@pytest.fixture
def folder() -> Path:
    spec = find_spec("axitom")
    found = None if spec is None or spec.origin is None else Path(spec.origin).parent / "tests" / "example_data"
    if found is None or not (found / "radiogram.tif").is_file():
        pytest.skip("axitom is not installed")
    return found


def test_a_radiogram_of_a_tensile_specimen_becomes_its_section(folder, tmp_path):
    """Half of the section, both averaged to voxels of 0.136 mm, up to the scale of the other software."""
    out, run = tmp_path / "scan.h5", tmp_path / "run"
    stated = "--white", "0.985", "--photons", "20000", "--axis-column", "736.5"
    coarse = "--bin", "10", "--every", "52", "--voxels", "200", "--size", "27.2"
    result = CliRunner().invoke(
        phantomgen, ["import", "nikon", str(folder / "radiogram.xtekct"), "-o", str(out), *stated, *coarse]
    )
    assert result.exit_code == 0, result.output
    with open_dataset(out) as dataset:
        assert dataset.counts.shape == (61, 1, 200, 150)
        assert dataset.geometry.panel.pitch == (2.0, 2.0)
    result = CliRunner().invoke(recon, ["fit", str(out), "--method", "fdk", "-o", str(run)])
    assert result.exit_code == 0, result.output
    with h5py.File(run / "volumes.h5") as file:
        volume = file["basis/data"][0]
        z = file["grid/origin"][0] + file["grid/spacing"][0] * np.arange(volume.shape[0])
    middle = volume.shape[1] // 2
    right, left = volume[:, :, middle : middle + 40], volume[:, :, middle - 40 : middle][:, :, ::-1]
    ours = np.mean([side[:, y] for side in (left, right) for y in (middle - 1, middle)], axis=0)[12:-12]
    other = tifffile.imread(folder / "recon_by_external_software.tif").astype(float).reshape(1999, 40, 10).mean(axis=2)
    rows = np.rint(z[12:-12] / VOXEL + 999).astype(int)
    theirs = np.stack([other[row - 5 : row + 5].mean(axis=0) for row in rows])
    scale, offset = np.polyfit(theirs.ravel(), ours.ravel(), 1)
    assert np.corrcoef(ours.ravel(), theirs.ravel())[0, 1] > 0.99
    assert np.abs(scale * theirs + offset - ours).mean() < 0.02 * np.ptp(np.percentile(ours, [5, 95]))


def mesh_chords(vertices: np.ndarray, faces: np.ndarray, source: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Lengths of rays (row, column, 3) in a closed mesh, from signed distances to its triangles."""
    unit = direction / np.linalg.norm(direction, axis=-1, keepdims=True)
    total = np.zeros(unit.shape[:2])
    for a, b, c in vertices[faces]:
        first, second, start = b - a, c - a, source - a
        across = np.cross(unit, second)
        volume = across @ first
        inverse = 1 / np.where(volume == 0, np.finfo(float).tiny, volume)
        along = np.cross(start, first)
        u, v, t = inverse * (across @ start), inverse * (unit @ along), inverse * (second @ along)
        inside = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
        total -= np.where(inside, np.sign(volume) * t, 0.0)
    return np.abs(total)


EXAMPLES = (
    "02_simple_scan_circular",
    "04_axis_tilt_static",
    "05_axis_wobble",
    "10_medical_gantry_circular",
    "11_arbitrary_axis_gantry_cone",
)


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_of_ctsimu_see_their_frame_of_iron_rods(name, tmp_path):
    """Projections by aRTist: CTSIMU_EXAMPLES names the folder examples of github.com/BAMresearch/ctsimu-scenarios."""
    folder = Path(os.environ.get("CTSIMU_EXAMPLES", "")) / name
    if not os.environ.get("CTSIMU_EXAMPLES") or not folder.is_dir():
        pytest.skip("CTSIMU_EXAMPLES does not name the folder of examples")
    metadata, out = folder / "projections" / f"{name}_metadata.json", tmp_path / "scan.h5"
    result = CliRunner().invoke(phantomgen, ["import", "ctsimu", str(metadata), "-o", str(out), "--photons", "1e6"])
    assert result.exit_code == 0, result.output
    sample = json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))["samples"][0]
    mesh = trimesh.load(folder / sample["file"]["value"])
    center = [sample["position"]["center"][axis]["value"] for axis in "uvw"]
    vertices = mesh.vertices - mesh.bounds.mean(axis=0) + center  # r and t are u and w in these
    iron = Material("Fe", composition="Fe").attenuation(np.array([130.0]))[0]
    with open_dataset(out) as dataset:
        geometry = dataset.geometry
        for view in range(0, len(geometry), 5):
            source, first, column, row = geometry.ray_frames()[view]
            u, v = np.arange(geometry.panel.columns)[None, :, None], np.arange(geometry.panel.rows)[:, None, None]
            lengths = mesh_chords(vertices, mesh.faces, source, first + u * column + v * row)
            found = dataset.line_integrals(view)[0]
            assert np.corrcoef(lengths.ravel(), found.ravel())[0, 1] > 0.98
            assert (lengths * found).sum() / (lengths**2).sum() == pytest.approx(iron, rel=0.06)
