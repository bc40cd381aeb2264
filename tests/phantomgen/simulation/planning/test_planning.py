"""Plans: what a tolerance chooses, that it is met by another reference, and what is said where it cannot be."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest

from phantomgen.ops.expected_counts import CROSSED, expected_counts, expected_counts_by_grid
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import fine_cuts, fine_transmission
from phantomgen.simulation.forward_model.expected_counts import spectrum_of
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.planning import make_plan as planning
from phantomgen.simulation.planning.cost import expected_cost
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.run import simulate
from spectra.errors import InputError
from spectra.threads import set_threads

TINY = ["geometry.views=4", "geometry.test_views=1", "panel.rows=48", "panel.columns=48", "panel.pitch=4.27"]
TINY += ["volume.voxels=16", "flats=2"]
TUBE = """
version: 1
name: tube
source: {type: monochromatic, energy: 60, photons: 1e5}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 500, sdd: 800, views: 2}
panel: {rows: 32, columns: 32, pitch: 2}
volume: {voxels: 8, size: 40}
materials: {water: {composition: water}}
objects:
  - {type: sweep, material: water, points: [[-8, 0, 0], [0, 1, 0.5], [8, 0, 0]], radius: 5, sides: 8, steps: 4}
tessellation: auto
"""


@pytest.fixture(scope="module")
def scan():
    return load_scene("kedge", TINY)


def rays_of(scan, settings, transmission):
    """Counts of all pixels of a view, with the classes of its pixels."""
    frame, panel = scan.geometry.ray_frames()[1], scan.geometry.panel
    spectrum, sampling = spectrum_of(scan, transmission), settings.sampling(scan.aperture)
    return frame, expected_counts(frame, panel.rows, panel.columns, scan.scene.solids, spectrum, sampling=sampling)


@pytest.mark.parametrize("tolerance", [1e-1, 1e-2, 1e-3, 2e-4])
def test_the_tolerance_holds_against_a_grid_of_rays_and_fine_energies(scan, tolerance):
    plan = make_plan(scan, tolerance)
    assert not plan.missed
    assert plan.error <= tolerance
    frame, found = rays_of(scan, plan.settings, plan.exposure.transmission)
    _, edges = rays_of(scan, make_plan(scan, 1e-3).settings, plan.exposure.transmission)
    pixels = np.argwhere(edges.classes >= CROSSED)[::25]
    fine = fine_transmission(scan)
    brute = expected_counts_by_grid(frame, pixels, scan.scene.solids, spectrum_of(scan, fine), n=256)
    level = fine.open_beam / plan.exposure.transmission.open_beam
    error = np.log(found.counts[:, pixels[:, 0], pixels[:, 1]].T * level / brute)
    assert len(pixels) > 5
    assert abs(error).max() < tolerance


def test_finer_tolerances_take_more_nodes_and_finer_rules(scan):
    coarse, fine = make_plan(scan, 1e-1), make_plan(scan, 1e-5)
    assert sum(coarse.nodes) < sum(fine.nodes)
    assert coarse.settings.sub_rays is not None
    assert fine.settings.sub_rays is None
    assert fine.settings.rules > coarse.settings.rules


def test_a_plan_depends_on_the_scan_alone(scan):
    plans = []
    for threads in (1, 2):
        set_threads(threads)
        plans.append(make_plan(scan, 1e-2).to_dict())
    set_threads(None)
    assert plans[0] == plans[1]


def test_sub_rays_of_the_scene_are_kept_and_judged():
    plan = make_plan(load_scene("kedge", [*TINY, "panel.sub_rays=2"]), 1e-3)
    assert plan.settings.sub_rays == 2
    assert plan.error > 1e-3
    assert [choice.part for choice in plan.missed] == ["pixels"]
    assert "as the scene says" in plan.text


@pytest.mark.slow
def test_a_tolerance_that_cannot_be_met_is_refused_with_what_is_reached(scan, tmp_path):
    with pytest.raises(InputError, match=r"--tol 1e-09 cannot be met: .* reach .*; \S+ can"):
        simulate(scan, tmp_path / "k.h5", tolerance=1e-9)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("tolerance", [0.0, -1.0, 2.0, np.nan])
def test_tolerances_that_make_no_sense_are_refused(scan, tolerance):
    with pytest.raises(InputError, match="--tol must lie in"):
        make_plan(scan, tolerance)


def test_the_default_tolerance_is_a_wish(tmp_path):
    summary = simulate(load_scene("kedge", [*TINY, "panel.sub_rays=1"]), tmp_path / "k.h5")
    assert any("the tolerance 0.001 is missed: pixels reach" in warning for warning in summary.warnings)


def test_the_file_tells_its_plan_and_the_measured_error(scan, tmp_path):
    summary = simulate(scan, tmp_path / "k.h5", tolerance=1e-2)
    with h5py.File(tmp_path / "k.h5") as file:
        told = json.loads(file["truth/plan/data"][()])
    assert told["tolerance"] == 1e-2
    assert told["settings"] == json.loads(json.dumps(summary.plan.settings.to_dict()))
    assert told["measured"] == summary.error.to_dict()
    assert told["measured"]["edge_worst"] < 1e-2


def test_the_file_is_as_large_as_expected(scan, tmp_path):
    summary = simulate(scan, tmp_path / "k.h5")
    cost = expected_cost(Views(scan, summary.plan.exposure, summary.plan.settings))
    assert 0.5 < cost.size / summary.size < 2
    assert set(cost.seconds) == {"views", "truth"}
    assert min(cost.seconds.values()) > 0


@pytest.mark.slow
def test_smooth_surfaces_become_as_fine_as_the_tolerance_needs():
    scan = load_scene(SceneFile("tube.yaml", TUBE))
    triangles = []
    for tolerance in (0.5, 0.02):
        plan = make_plan(scan, tolerance)
        assert "tessellation" in [choice.part for choice in plan.choices]
        assert not plan.missed
        triangles.append(len(plan.scan.scene.solids.surfaces.triangles))
        assert f"tessellation: {[1, 2, 4, 8][len(plan.choices[1].trials) - 1]}" in plan.scan.text
    assert triangles[1] > triangles[0]


@pytest.mark.slow
def test_solutions_of_many_agents_take_some_dozens_of_nodes_at_tight_tolerances():
    scan = load_scene("multi-energy", ["geometry.views=4", "geometry.test_views=1"])
    exposure, energies = planning._energies(scan, planning.ENERGY * 1e-5)
    assert energies.met
    assert len(exposure.transmission.weights) < 120
    rays = sampled_lengths(scan)[::23]
    fine = fine_transmission(scan, fine_cuts(scan, sampled_lengths(scan), 1e-7)[0])
    assert abs(exposure.transmission.log_projection(rays) - fine.log_projection(rays)).max() < energies.share


def test_it_is_said_before_views_are_computed_where_all_bins_are_kept(scan, monkeypatch, caplog):
    def kept(scan, lengths, tolerance, refine, cuts):
        return Exposure(fine_transmission(scan, cuts), scan.detector.names, np.arange(4), None), 0.0

    make_plan(scan, 1e-1)
    assert not caplog.records
    monkeypatch.setattr(Exposure, "of", kept)
    make_plan(scan, 1e-1)
    [record] = caplog.records
    assert "no fewer energy nodes than all" in record.message
    assert "times longer" in record.message


@pytest.mark.parametrize(("part", "said"), [(0.5, "meets"), (1.0, "meets"), (1.004, "MISSES"), (3.0, "MISSES")])
def test_a_plan_that_misses_shows_the_digits_by_which_it_does(scan, part, said):
    plan = make_plan(scan, 1e-1)
    choices = (replace(plan.choices[0], error=part * 1e-1, of_pixels=False),)
    error, verdict, tolerance = replace(plan, choices=choices).text.splitlines()[-1].split()[1:]
    assert (verdict, float(tolerance)) == (said, 1e-1)
    assert (float(error) > 1e-1) == (said == "MISSES")
