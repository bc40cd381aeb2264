"""Objects and materials in time: where they are, against the same scene at rest, and scenes that cannot be."""

import numpy as np
import pytest

from phantomgen.scene.dynamics.object_motion import ObjectMotion, total_motion
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import Scan, load_scene
from spectra.errors import InputError, SceneError

SCENE = """\
version: 1
name: moving
source: {type: monochromatic, energy: 60, photons: 1.0e6}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 8, test_views: 2}
panel: {rows: 9, columns: 11, pitch: 3}
volume: {voxels: 10, size: 20}
time:
  duration: 8
  signals:
    ramp: {type: table, times: [0, 8], values: [0, 1]}
    turn: {type: sine, period: 4}
  phases: {count: 4, signal: turn}
materials:
  blood: {composition: water, density: 1.05}
  peak: {solution: {solvent: blood, solutes: {I: 20}}}
  vessel: {inflow: {rest: blood, peak: peak, signal: ramp}}
objects:
  - {type: cylinder, material: vessel, radius: 4, length: 12}
  - {type: sphere, material: water, center: [0, 5, 0], radius: 2, motion: {signal: ramp, shift: [0, 0, 4], scale: 2}}
noise: false
"""


def moving(*overrides: str) -> Scan:
    return load_scene(SceneFile("moving.yaml", SCENE, overrides))


def test_motion_scales_and_turns_around_the_pivot_and_shifts():
    motion = ObjectMotion("s", (1.0, 2.0, 3.0), (10.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2), (2.0, 1.0, 1.0))
    matrix = motion.matrix(1.0)
    assert matrix @ [1, 2, 3, 1] == pytest.approx([11, 2, 3, 1])
    assert matrix @ [2, 2, 3, 1] == pytest.approx([11, 4, 3, 1])  # stretched to 2 along x, then turned to y
    assert motion.matrix(0.0) == pytest.approx(np.eye(4))


def test_a_path_passes_its_points_at_equal_steps_and_ends_there():
    points = ((0.0, 0.0, 0.0), (1.0, 2.0, 0.0), (4.0, 0.0, 1.0))
    motion = ObjectMotion("s", (0.0, 0.0, 0.0), path=points)
    for value, point in ((0.0, points[0]), (0.5, points[1]), (1.0, points[2]), (3.0, points[2])):
        assert motion.matrix(value)[:3, 3] == pytest.approx(point, abs=1e-12)


def test_a_member_of_a_turned_group_moves_along_the_turned_axis_and_with_the_group():
    scan = moving(
        "objects.1={type: group, center: [0, 0, 3], rotation: [0, 0, 90], motion: {signal: ramp, shift: [0, 0, 1]}, "
        "objects: [{type: sphere, material: water, radius: 1, motion: {signal: ramp, shift: [2, 0, 0]}}]}"
    )
    low, high = scan.at_time(8.0).scene.objects[1][0].bounds
    assert (low + high) / 2 == pytest.approx([0, 2, 4])
    motions = scan.dynamics.motions[1]
    assert total_motion(motions, {"ramp": 0.5}) @ [0, 0, 3, 1] == pytest.approx([0, 1, 3.5, 1])


def test_copies_of_a_ring_move_outwards_each_in_its_own_direction():
    scan = moving(
        "objects.1={type: sphere, material: water, center: [5, 0, 0], radius: 1, repeat: {type: ring, count: 4}, "
        "motion: {signal: ramp, shift: [1, 0, 0]}}"
    )
    middles = [np.mean(shape.bounds, axis=0) for shape, _ in scan.at_time(8.0).scene.objects[1:]]
    assert np.array(middles) == pytest.approx(np.array([[6, 0, 0], [0, 6, 0], [-6, 0, 0], [0, -6, 0]]), abs=1e-12)


def test_an_inflow_is_a_mixture_by_volume_of_rest_and_peak():
    scan = moving()
    names = [material.name for material in scan.scene.materials]
    half = scan.at_time(4.0).scene
    lengths = half.path_lengths(np.array([[0.0, 0.0, -20.0]]), np.array([[0.0, 0.0, 40.0]]))[0]
    assert lengths[names.index("vessel")] == pytest.approx(6)
    assert lengths[names.index("peak")] == pytest.approx(6)
    energy = np.array([40.0, 60.0])
    curves = np.array([m.attenuation(energy, scan.basis) for m in scan.scene.materials])
    half_dose = load_scene(SceneFile("half.yaml", SCENE, ("materials.peak.solution.solutes.I=10",)))
    peak = next(m for m in half_dose.scene.materials if m.name == "peak")
    assert lengths @ curves == pytest.approx(12 * peak.attenuation(energy, half_dose.basis), rel=1e-9)


def test_phases_of_a_cycle_are_centred_at_its_beginning_and_those_of_time_begin_there():
    assert moving().dynamics.phase_of_view.tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 2, 2]
    by_time = moving("time.phases={count: 4}").dynamics.phase_of_view
    assert by_time.tolist() == [0, 0, 1, 1, 2, 2, 3, 3, 1, 3]


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("objects.1.motion.signal=rmp", "objects.1.motion.signal - there is no signal 'rmp'; did you mean 'ramp'?"),
        ("materials.vessel.inflow.peak=peek", "materials.vessel.inflow.peak - unknown material 'peek'"),
        ("materials.vessel.inflow.signal=x", "there is no signal 'x': choose from ramp, turn"),
        ("time.signals.ramp.values=[0, 2]", "follows a signal from 0 to 1, but 'ramp' reaches 2"),
        ("time.signals.ramp.values=[-0.5, 1]", "follows a signal from 0 to 1, but 'ramp' reaches -0.5"),
        ("time.signals.ramp.times=[8, 0]", "times of a signal must ascend"),
        ("materials.peak={inflow: {rest: blood, peak: water, signal: ramp}}", "'peak' is an inflow itself"),
        ("time.phases={count: 9, signal: turn}", "5 of 9 phases hold no training view, the first is phase 1"),
        ("time.phases={count: 2, signal: ramp}", "'ramp' does not repeat: leave it out"),
        ("overlap=add", "time - objects that add up cannot move or change"),
        ("objects.0={type: union, material: water, shapes: [{type: sphere, radius: 1, motion: {signal: ramp}}]}",
         "belongs to the whole object"),
    ],
)  # fmt: skip
def test_scenes_that_cannot_be_are_refused_with_the_key(override, words):
    with pytest.raises(SceneError) as error:
        moving(override)
    assert words in str(error.value)


def test_motion_without_a_section_time_says_where_signals_belong():
    text = SCENE[: SCENE.index("time:")] + SCENE[SCENE.index("materials:") :].replace("vessel, radius", "blood, radius")
    with pytest.raises(SceneError, match=r"there is no signal 'ramp': give it below time.signals"):
        load_scene(SceneFile("moving.yaml", text))


def test_an_object_that_shrinks_to_nothing_is_refused():
    with pytest.raises(InputError, match=r"keeps at least 0\.01 of it"):
        ObjectMotion("s", (0.0, 0.0, 0.0), scale=(0.5, 1.0, 1.0)).matrix(2.0)
