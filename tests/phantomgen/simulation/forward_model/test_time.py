"""Scans of scenes in time, against scans of the same objects at rest where they are at each view."""

import h5py
import numpy as np
import pytest

from phantomgen.dataset.describe import describe, describe_text
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.time.true_phases import read_phases, read_signals
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.validate import validate
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.truth import scan_truth
from phantomgen.simulation.run import simulate
from spectra.errors import InputError

SCENE = """\
version: 1
name: moving
source: {type: monochromatic, energy: 60, photons: 1.0e6}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 8}
panel: {rows: 9, columns: 12, pitch: 3}
volume: {voxels: 10, size: 20}
time:
  duration: 8
  signals: {ramp: {type: table, times: [0, 8], values: [0, 1]}}
  phases: {count: 4}
materials:
  blood: {composition: water, density: 1.05}
  peak: {solution: {solvent: blood, solutes: {I: 20}}}
  vessel: {inflow: {rest: blood, peak: peak, signal: ramp}}
objects:
  - {type: cylinder, material: vessel, radius: 4, length: 12}
  - {type: sphere, material: water, center: [0, 5, 0], radius: 2, motion: {signal: ramp, shift: [0, 0, 4], scale: 2}}
noise: false
"""


def scan_of(*overrides: str):
    return load_scene(SceneFile("moving.yaml", SCENE, overrides))


def at_rest(view: int, *overrides: str):
    """The scene as it is at a view, written as a scene without time."""
    part = view / 8
    text = SCENE[: SCENE.index("time:")] + SCENE[SCENE.index("materials:") :]
    text = text.replace(
        "{inflow: {rest: blood, peak: peak, signal: ramp}}",
        f"{{solution: {{solvent: blood, solutes: {{I: {20 * part}}}}}}}",
    )
    text = text.replace("radius: 2, motion: {signal: ramp, shift: [0, 0, 4], scale: 2}", f"radius: {2 * (1 + part)}")
    return load_scene(
        SceneFile("rest.yaml", text.replace("center: [0, 5, 0]", f"center: [0, 5, {4 * part}]"), overrides)
    )


def counts_of(scan, tmp_path, **options):
    path = tmp_path / f"{len(list(tmp_path.iterdir()))}.h5"
    simulate(scan, path, tolerance=1e-4, **options)
    with open_dataset(path) as dataset:
        return path, dataset.load()


FLAT, CURVED = (), ("panel.curvature={radius: 200, module_columns: 4}",)
SCATTER = ("effects.scatter={type: compton}",)


@pytest.mark.parametrize("how", [FLAT, CURVED, SCATTER], ids=["flat", "curved", "scatter"])
def test_each_view_shows_the_objects_where_they_are_then(tmp_path, how):
    _, moving = counts_of(scan_of(*how), tmp_path)
    for view in (0, 3, 7):
        _, rest = counts_of(at_rest(view, *how), tmp_path)
        assert np.abs(np.log(moving[view] / rest[view])).max() < 3e-4


def test_an_exposure_is_the_mean_over_its_instants(tmp_path):
    _, long = counts_of(scan_of("time.exposure=2"), tmp_path)
    instants = 4 + np.sqrt(3 / 5) * np.array([-1.0, 0.0, 1.0])  # of the rule of Gauss with three nodes
    counts = [counts_of(scan_of().at_time(time), tmp_path)[1][4] for time in instants.tolist()]
    assert long[4] == pytest.approx(np.tensordot(np.array([5, 8, 5]) / 18, counts, axes=1), rel=1e-4)


def test_the_file_states_times_phases_and_truth_of_each_phase(tmp_path):
    scan = scan_of("time.signals.beat={type: cardiac, period: 2}")
    path, _ = counts_of(scan, tmp_path)
    assert not list(validate(path))
    with open_dataset(path) as dataset:
        times = dataset.view_times
    assert times.time.tolist() == list(range(8))
    assert (times.phase.tolist(), times.phases) == ([0, 0, 1, 1, 2, 2, 3, 3], 4)
    assert times.cycles["beat"] == pytest.approx([0, 0.5] * 4)
    assert "ramp" not in times.cycles  # no scanner knows it
    assert "time       0 to 7 s, 4 phases; cycles: beat" in describe_text(describe(path))
    assert read_signals(path)["ramp"] == pytest.approx(np.arange(8) / 8)
    phases, whole = read_phases(path), read_truth(path)
    assert phases.mean(axis=0) == pytest.approx(whole.volumes, abs=1e-7)
    both = [scan_truth(at_rest(view)).volumes for view in (2, 3)]
    assert phases[1] == pytest.approx(np.mean(both, axis=0), abs=2e-4 * float(whole.volumes.max()))


def test_materials_that_change_alone_have_the_truth_of_the_mixture(tmp_path):
    path, _ = counts_of(scan_of("objects.1.motion=null"), tmp_path)
    truth, coefficients = read_truth(path), None
    with h5py.File(path) as file:
        fractions = file["truth/phases/fractions"][:] / 65535
        coefficients = file["truth/materials/coefficients"][:]
    names = truth.material_names
    inside = fractions[:, :, 5, 5, 5]
    assert inside[:, names.index("peak")] == pytest.approx([0.5 / 8, 2.5 / 8, 4.5 / 8, 6.5 / 8], abs=1e-4)
    assert inside.sum(axis=1) == pytest.approx(np.ones(4), abs=1e-4)
    assert read_phases(path)[:, :, 5, 5, 5] == pytest.approx(inside @ coefficients, abs=1e-6)


def test_projections_of_a_scene_in_time_are_not_kept(tmp_path):
    with pytest.raises(InputError, match="with `time` are not kept"):
        simulate(scan_of(), tmp_path / "out.h5", keep_paths=True)
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.parametrize("threads", [1, 2])
def test_bits_do_not_depend_on_threads(tmp_path, threads):
    from spectra.threads import set_threads

    set_threads(threads)
    try:
        _, counts = counts_of(scan_of("noise=true"), tmp_path)
    finally:
        set_threads(None)
    reference = tmp_path / "again"
    reference.mkdir()
    _, again = counts_of(scan_of("noise=true"), reference)
    assert np.array_equal(counts, again)


def test_a_degraded_scan_keeps_the_times_of_the_views_that_are_left(tmp_path):
    from phantomgen.degradation.run import degrade_file
    from phantomgen.degradation.settings import Degradation

    path, _ = counts_of(scan_of(), tmp_path)
    few = tmp_path / "few.h5"
    degrade_file(path, few, Degradation(views=4))
    assert not list(validate(few))
    with open_dataset(few) as dataset:
        times = dataset.view_times
    assert times.time.tolist() == [0, 2, 4, 6]
    assert times.phase.tolist() == [0, 1, 2, 3]
    assert read_signals(few)["ramp"] == pytest.approx([0, 0.25, 0.5, 0.75])
