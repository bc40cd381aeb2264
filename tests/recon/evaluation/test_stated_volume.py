"""Volumes of other programs beside a truth that is computed without the basis of the dataset, and remarks on them."""

import h5py
import numpy as np
import pytest
from click.testing import CliRunner
from skimage.transform import iradon

import recon
from phantomgen.cli.main import main as phantomgen
from phantomgen.dataset.truth import read_truth
from recon.evaluation.stated_volume import better_factor, better_orientation
from spectra.elements.attenuation import linear_attenuation

SCENE = """\
version: 1
name: parallel
source: {type: monochromatic, energy: 60, photons: 1000000}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: parallel, distance: 100, views: 96, test_views: 2}
panel: {rows: 33, columns: 33, pitch: 1.5}
volume: {voxels: 33, size: 49.5}
basis: [{type: photoelectric}, {type: compton}]
materials:
  water: {composition: "Water, Liquid"}
  bone: {composition: cortical bone}
objects:
  - {type: cylinder, material: water, radius: 18, length: 30}
  - {type: sphere, material: bone, center: [8, -3, 2], radius: 6}
  - {type: sphere, material: bone, center: [-4, 9, -6], radius: 4}
"""


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("parallel")
    (folder / "p.yaml").write_text(SCENE)
    made = CliRunner().invoke(phantomgen, ["make", str(folder / "p.yaml"), "-o", str(folder / "p.h5"), "-q"])
    assert made.exit_code == 0, made.output
    return folder / "p.h5"


@pytest.fixture(scope="module")
def of_scikit_image(scan):
    """Filtered back-projection by scikit-image, from arrays of the file alone: (panel row, its rows, its columns)."""
    with h5py.File(scan) as file:
        entry = file["entry"]
        counts, flat = entry["instrument/detector/data"][:, 0], entry["instrument/flat/data"][:, 0].mean(axis=0)
        train = entry["splits"][entry["splits"].attrs["default"]]["train"][()]
        angles = -entry["sample/rotation_angle"][()]  # of the source around the sample
        logs = np.log(flat / np.maximum(counts, 1.0))[train]
    slices = [
        iradon(logs[:, r].T, theta=angles[train], filter_name="ramp") / 1.5 for r in range(33)
    ]  # pixels of 1.5 mm
    return np.stack(slices)


def test_filtered_back_projection_of_scikit_image(scan, of_scikit_image):
    """Its formula t = column cos a - row sin a against ours, t = y cos a - x sin a: rows are x, columns y."""
    stated = {"quantity": "mono:60", "units": "1/mm", "same_grid": True}
    found = recon.score(of_scikit_image, scan, axes="-zxy", **stated)
    row = found["attenuation"]["attenuation_60_keV"]
    truth = read_truth(scan)
    exact = [
        linear_attenuation(c, d, np.array([60.0]))[0] for c, d in (("Water, Liquid", 1.0), ("cortical bone", 1.92))
    ]
    order = [("water", "bone").index(name) for name in truth.material_names]
    right = np.tensordot(np.array(exact)[order], truth.fractions / 65535, axes=1)
    ours = of_scikit_image[::-1].transpose(0, 2, 1)
    rmse = np.sqrt(np.mean((ours - right) ** 2))
    assert row["rmse"] == pytest.approx(rmse, rel=1e-3)
    assert row["psnr"] == pytest.approx(20 * np.log10(right.max() / rmse), abs=0.01)
    assert row["psnr"] > 33
    assert found["remarks"] == []
    centimetres = recon.score(10 * of_scikit_image, scan, axes="-zxy", **stated | {"units": "1/cm"})
    assert centimetres["attenuation"]["attenuation_60_keV"]["psnr"] == pytest.approx(row["psnr"])


@pytest.mark.parametrize("axes", ["zxy", "-zyx", "-z-xy", "-zx-y"])
def test_other_orientations_are_worse_and_remarked(scan, of_scikit_image, axes):
    found = recon.score(of_scikit_image, scan, "mono:60", units="1/mm", axes=axes, same_grid=True)
    assert found["attenuation"]["attenuation_60_keV"]["psnr"] < 30
    assert "the mean square error would be" in found["remarks"][0]


def test_orientations_and_factors_need_a_clear_gain():
    rng = np.random.default_rng(0)
    truth = np.zeros((1, 6, 6, 6))
    truth[0, 1:3, 2:5, 4:] = 1.0
    assert better_orientation(truth, truth) is None
    assert better_orientation((0.98 * truth).astype(np.float32), truth) is None
    assert better_orientation(rng.normal(size=truth.shape), truth) is None
    found = better_orientation(truth[:, ::-1], truth)
    assert (found.words, found.gain) == ("mirrored along z", pytest.approx(1))
    np.testing.assert_array_equal(found.volumes, truth)
    assert better_orientation(3 * truth.transpose(0, 3, 2, 1), truth).words == "with the axes xyz in place of zyx"
    assert better_factor(0.1 * truth[0], truth[0]) == 10
    assert better_factor(1.7 * truth[0], truth[0]) is None
    assert better_factor(rng.normal(size=truth.shape)[0], truth[0]) is None
    assert better_factor(0 * truth[0], truth[0]) is None
