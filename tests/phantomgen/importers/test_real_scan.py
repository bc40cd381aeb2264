"""A real radiogram by a Nikon scanner, which the package axitom brings, against what the scanner's software made.

Optional: runs where axitom is installed (``pip install axitom``).
"""

from importlib.util import find_spec
from pathlib import Path

import h5py
import numpy as np
import pytest
import tifffile
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.reader import open_dataset
from recon.cli.main import main as recon

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
