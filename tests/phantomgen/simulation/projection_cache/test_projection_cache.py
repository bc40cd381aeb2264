"""Kept projections: what comes from them is what rays give, and they are used for nothing else."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.projection_cache.cache import ProjectionCache, cached_scene
from phantomgen.simulation.projection_cache.energies import cache_energies
from phantomgen.simulation.run import simulate
from spectra.errors import DatasetError, InputError
from spectra.materials.material import Material

SCENE = """\
version: 1
name: toy
source: {type: band, energy: 60, width: 60, shape: box, photons: 1.0e5}
detector: {type: photon_counting, thresholds: [30, 50.2391, 65]}
geometry: {type: circular, sod: 100, sdd: 200, views: 3, test_views: 1}
panel: {rows: 12, columns: 14, pitch: 1.5}
volume: {voxels: 8, size: 20}
materials:
  water: {composition: H2O, density: 1.0}
  gadolinium: {composition: {H: 0.1, O: 0.82, Gd: 0.08}, density: 1.1}
objects:
  - {type: sphere, material: water, radius: 7}
  - {type: cylinder, material: gadolinium, radius: 2, length: 6, center: [2, 1, 0]}
flats: 2
"""
# Of the kept projections and of what they are compared with, so that twice this may come together.
TOLERANCE = 2e-4
OTHERS = {
    "dose": ["source.photons=1.0e3"],
    "spectrum": ["source={type: band, energy: 100, width: 100, shape: box, photons: 1.0e5}"],
    "line": ["source={type: monochromatic, energy: 57.3, photons: 1.0e5}", "detector.thresholds=[30]"],
    "thresholds": ["detector.thresholds=[33, 41, 70]"],
    "integrating": ["detector={type: energy_integrating, composition: CsI, thickness: 0.5}"],
    "beam": ["source.bowtie={composition: Al, angles: [0, 5], thickness: [1, 8]}"],
    "output": ["effects.tube_output.sigma=0.05", "effects.scatter={type: kernel, ratio: 0.2, width: 5}"],
}


def toy(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, ("noise=false", *overrides)))


def interrupt(*_):
    raise KeyboardInterrupt


def expected(path):
    with open_dataset(path) as dataset:
        return dataset.load().astype(np.float64), dataset.flat


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    path = tmp_path_factory.mktemp("kept") / "kept.h5"
    simulate(toy(), path, keep_paths=True, tolerance=TOLERANCE)
    return path


def test_keeping_changes_no_count_and_the_file_is_valid(kept, tmp_path):
    simulate(toy(), tmp_path / "a.h5", tolerance=TOLERANCE)
    np.testing.assert_array_equal(expected(kept)[0], expected(tmp_path / "a.h5")[0])
    assert validate(kept) == []


def test_projections_are_those_of_the_energies_in_the_file(kept):
    with h5py.File(kept) as file:
        energy, views = file["truth/paths/energy"][()], file["truth/paths/data"]
        assert views.dtype == np.float32
        node = np.abs(energy - 60).argmin()
        line = toy(f"source={{type: monochromatic, energy: {energy[node]}, photons: 1.0}}", "detector.thresholds=[15]")
        path = kept.with_name("line.h5")
        simulate(line, path, tolerance=TOLERANCE)
        counts, flat = expected(path)
        np.testing.assert_allclose(views[:, node], -np.log(counts / flat)[:, 0], atol=2 * TOLERANCE)


@pytest.mark.parametrize("name", OTHERS)
def test_other_scans_are_those_that_rays_give(kept, tmp_path, name):
    scan = load_scene(cached_scene(kept, OTHERS[name]))
    summary = simulate(scan, tmp_path / "fast.h5", paths=kept, tolerance=TOLERANCE)
    simulate(scan, tmp_path / "slow.h5", tolerance=TOLERANCE)
    (fast, flat), (slow, same) = expected(tmp_path / "fast.h5"), expected(tmp_path / "slow.h5")
    np.testing.assert_allclose(flat, same, rtol=2 * TOLERANCE)
    np.testing.assert_allclose(np.log(fast), np.log(slow), atol=2 * TOLERANCE)
    assert summary.plan.choices[-1].part == "kept projections"
    assert summary.error.edge_worst < 2 * TOLERANCE


def test_the_truth_is_that_of_the_file_or_made_anew(kept, tmp_path):
    for voxels in (8, 6):
        scan = load_scene(cached_scene(kept, [f"volume.voxels={voxels}"]))
        simulate(scan, tmp_path / f"{voxels}.h5", paths=kept)
        simulate(scan, tmp_path / f"{voxels}-rays.h5")
        one, other = (read_truth(tmp_path / f"{voxels}{kind}.h5") for kind in ("", "-rays"))
        np.testing.assert_array_equal(one.fractions, other.fractions)
        np.testing.assert_allclose(one.volumes, other.volumes, atol=1e-5 * other.volumes.max())


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (["objects.0.radius=6"], "objects differ"),
        (["materials.water.density=1.01"], "materials differ"),
        (["geometry.views=4"], "geometry or panel differ"),
        (["panel.columns=15"], "geometry or panel differ"),
        (["effects.focal_spot={width: 1, height: 1}"], r"effects\.focal_spot differ"),
        (["effects.aperture={width: 0.9, height: 0.9}"], r"effects\.aperture differ"),
        (["objects.0.radius=6", "background=water"], "objects and materials differ"),
        (["detector.thresholds=[15]", "source.width=100"], "from 20 to 160 keV, but photons of 15 to"),
    ],
)
def test_projections_of_another_scan_are_refused(kept, tmp_path, settings, named):
    scan = load_scene(cached_scene(kept, settings))
    with pytest.raises(InputError, match=named):
        simulate(scan, tmp_path / "a.h5", paths=kept)
    assert not list(tmp_path.iterdir())


def test_only_datasets_that_keep_projections_are_taken(kept, tmp_path):
    simulate(toy(), tmp_path / "a.h5")
    with pytest.raises(DatasetError, match="keeps no projections: make it with --keep paths"):
        ProjectionCache.read(tmp_path / "a.h5")
    with pytest.raises(InputError, match="--keep paths traces rays"):
        simulate(toy(), tmp_path / "b.h5", paths=kept, keep_paths=True)
    with pytest.raises(InputError, match="is the file that --paths reads"):
        simulate(toy(), kept, paths=kept, overwrite=True)


def test_an_interrupted_run_goes_on_to_the_same_file(kept, tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    for name, options in (("keep", {"keep_paths": True}), ("use", {"paths": kept})):
        whole, path = tmp_path / f"{name}.h5", tmp_path / f"{name}-resumed.h5"
        simulate(toy(), whole, **options)
        with monkeypatch.context() as patch:
            patch.setattr("phantomgen.simulation.run.write_frames", interrupt)
            with pytest.raises(KeyboardInterrupt):
                simulate(toy(), path, **options)
        simulate(toy(), path, resume=True, **options)
        assert path.read_bytes() == whole.read_bytes()


def test_interpolation_errs_by_less_than_its_share_behind_anything():
    scan = toy()
    tight, loose = (cache_energies(scan, share) for share in (1e-5, 1e-3))
    assert sum(tight[0].counts) > sum(loose[0].counts)
    assert tight[1] < 3e-5
    assert 50.2391 in np.round(tight[0].bounds, 4)
    lead = replace(scan, scene=replace(scan.scene, materials=(Material("lead", 11.35, "Pb"),) * 2))
    energies, error = cache_energies(lead, 1e-4)  # nothing passes at most energies
    assert np.isfinite(energies.matrix(np.linspace(20, 160, 99))).all()
    assert error < 1e-3


def test_the_command_takes_the_scene_from_the_file(kept, tmp_path):
    out = tmp_path / "low.h5"
    arguments = ["make", "--paths", str(kept), "--set", "source.photons=100", "--noise", "--seed", "3", "-o", str(out)]
    result = CliRunner().invoke(main, arguments)
    assert result.exit_code == 0, result.output
    assert f"from {kept.name}" in result.output
    with open_dataset(out) as dataset:
        assert dataset.load().dtype == np.int32
