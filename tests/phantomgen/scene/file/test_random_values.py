"""Random values in scene files: each has a key of its own, draws what it says, and complains where it stands."""

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from phantomgen.scene.file.random_values import draw, numbers
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.shapes import Sphere
from spectra.errors import SceneError

SCENE = """\
version: 1
name: toy
source: {type: monochromatic, energy: 60, photons: 1.0e4}
detector: {type: photon_counting, thresholds: [20]}
geometry: {type: circular, sod: 100, sdd: 200, views: 2}
panel: {rows: 4, columns: 4, pitch: 20}
volume: {voxels: 4, size: 40}
materials: {water: {composition: "Water, Liquid"}, bone: {composition: cortical bone}}
objects:
  - {type: cylinder, material: water, radius: {uniform: [8, 9]}, length: 20}
  - name: beads
    count: 12
    type: sphere
    material: {choice: [water, bone]}
    radius: {log_uniform: [0.1, 1]}
    within: {type: cylinder, radius: 7, length: 18}
    gap: 0.2
"""


def toy(*overrides: str) -> SceneFile:
    return SceneFile("toy.yaml", SCENE, overrides)


def refuse(location, message):
    return SceneError(f"{'.'.join(map(str, location))} - {message}")


def drawn(value, count: int = 1, seed: int = 0):
    objects = draw({"seed": seed, "objects": [{"name": "o", "count": count, "x": value}]}, refuse)["objects"]
    return [o["x"] for o in objects]


def test_the_same_seed_draws_the_same_scene_and_another_one_another():
    first, again, other = (toy(f"seed={seed}").resolved for seed in (7, 7, 8))
    assert first == again
    assert first.replace("seed: 7", "") != other.replace("seed: 8", "")


def test_a_drawn_scene_is_a_scene_that_stays_as_it_is():
    text = toy("seed=3").resolved
    assert SceneFile("again.yaml", text).resolved == text
    assert load_scene(toy("seed=3")).text == text


@pytest.mark.parametrize(
    ("value", "mean", "deviation", "low", "high"),
    [
        ({"uniform": [2, 5]}, 3.5, 3 / np.sqrt(12), 2, 5),
        ({"log_uniform": [1, np.e]}, np.e - 1, np.sqrt((np.e**2 - 1) / 2 - (np.e - 1) ** 2), 1, np.e),
        ({"normal": [4, 2]}, 4, 2, -6, 14),
        ({"normal": [0, 1], "min": 0}, np.sqrt(2 / np.pi), np.sqrt(1 - 2 / np.pi), 0, 6),
        ({"integers": [1, 6]}, 3.5, np.sqrt(35 / 12), 1, 6),
        ({"choice": [1, 2, 9]}, 4, np.sqrt(38 / 3), 1, 9),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_moments_and_limits(value, mean, deviation, low, high):
    n = 20_000
    x = np.array(drawn(value, n))
    assert abs(x.mean() - mean) < 4 * deviation / np.sqrt(n)
    assert x.std() == pytest.approx(deviation, rel=0.03)
    assert low <= x.min() < x.max() <= high
    assert np.abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 4 / np.sqrt(n)


def test_truncation_keeps_the_shape_of_what_is_left():
    x = np.array(drawn({"normal": [0, 1], "min": -0.5, "max": 2}, 20_000))
    inside = np.random.default_rng(1).normal(size=80_000)
    inside = inside[(inside > -0.5) & (inside < 2)]
    assert np.abs(np.quantile(x, [0.1, 0.5, 0.9]) - np.quantile(inside, [0.1, 0.5, 0.9])).max() < 0.03


def test_integers_are_equally_likely_and_whole():
    x = drawn({"integers": [3, 5]}, 6000)
    assert {type(value) for value in x} == {int}
    assert np.bincount(x).tolist() == pytest.approx([0, 0, 0, 2000, 2000, 2000], abs=150)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**63), st.text(max_size=5), st.integers(0, 20), st.integers(0, 20))
def test_more_items_do_not_change_the_first_ones(seed, name, few, more):
    first, all_ = numbers(str(seed), (name, "x"), few), numbers(str(seed), (name, "x"), few + more)
    assert (first == all_[:few]).all()
    assert (first != numbers(str(seed), (name, "y"), few)).all()
    assert (first != numbers(str(seed + 1), (name, "x"), few)).all()


def test_named_objects_keep_their_values_behind_others():
    """Values of an entry with a name do not depend on what stands before or beside it, nor on how many are drawn."""
    scene = yaml.safe_load(SCENE)
    before = draw(scene, refuse)["objects"][1:]
    extra = {"name": "first", "type": "sphere", "material": "water", "radius": {"uniform": [1, 2]}}
    after = draw({**scene, "objects": [extra, *scene["objects"]]}, refuse)["objects"][2:]
    assert after == before
    scene["objects"][1].update(count=15, material="water")
    more = draw(scene, refuse)["objects"][1:]
    assert [o["radius"] for o in more[:12]] == [o["radius"] for o in before]


def test_entries_without_a_name_go_by_their_index():
    value = {"uniform": [0, 1]}
    alone = draw({"objects": [{"x": value}]}, refuse)["objects"][0]["x"]
    pair = draw({"objects": [{"x": value}, {"x": value}]}, refuse)["objects"]
    assert pair[0]["x"] == alone != pair[1]["x"]
    assert draw({"objects": [{"name": "1", "x": value}]}, refuse)["objects"][0]["x"] == pair[1]["x"]


def test_members_of_drawn_groups_differ():
    group = {"count": 3, "objects": [{"count": 2, "x": {"uniform": [0, 1]}}]}
    found = [o["x"] for g in draw({"objects": [group]}, refuse)["objects"] for o in g["objects"]]
    assert len(set(found)) == 6


def test_keys_beside_a_choice_belong_to_every_option():
    entry = {
        "count": 40,
        "material": "m",
        "choice": [{"type": "sphere", "radius": {"uniform": [1, 2]}}, {"type": "box"}],
    }
    found = draw({"objects": [entry]}, refuse)["objects"]
    assert {o["type"] for o in found} == {"sphere", "box"}
    assert {o["material"] for o in found} == {"m"}
    assert len({o["radius"] for o in found if o["type"] == "sphere"}) == sum(o["type"] == "sphere" for o in found) > 9


def test_a_count_may_be_zero_and_may_be_drawn():
    counts = [len(toy(f"seed={i}", "objects.1.count={integers: [0, 4]}").model.objects) - 1 for i in range(30)]
    assert set(counts) == {0, 1, 2, 3, 4}


def test_the_normal_of_a_plane_is_no_distribution():
    file = toy("objects.0.clip=[{normal: [0, 0, 1], offset: {uniform: [3, 4]}}]")
    plane = file.model.objects[0].clip[0]
    assert plane.normal == (0, 0, 1)
    assert 3 <= plane.offset <= 4


def overlaps(scene) -> np.ndarray:
    """Distances of the surfaces of all pairs of spheres."""
    balls = [shape for shape, _ in scene.objects if isinstance(shape, Sphere)]
    center, radius = np.array([b.center for b in balls]), np.array([b.radius for b in balls])
    apart = np.linalg.norm(center[:, None] - center, axis=2) - radius[:, None] - radius
    return apart[np.triu_indices(len(balls), 1)]


def test_gap_keeps_objects_apart_and_within_keeps_them_inside():
    scan = load_scene(toy())
    assert overlaps(scan.scene).min() >= 0.2
    for shape, _ in scan.scene.objects[1:]:
        assert np.hypot(*shape.center[:2]) + shape.radius <= 7
        assert abs(shape.center[2]) + shape.radius <= 9
    crowded = load_scene(
        toy(
            "objects.1.gap=null",
            "objects.1={count: 60, type: sphere, material: water, radius: 2, within: {type: sphere, radius: 7}}",
        )
    )
    assert overlaps(crowded.scene).min() < -1


def test_the_preset_foam_has_no_overlaps_and_the_volume_that_it_says():
    scan = load_scene("foam")
    radius = np.array([shape.radius for shape, _ in scan.scene.objects[1:]])
    assert len(radius) == 1000
    assert overlaps(scan.scene).min() >= 0.05
    assert (4 / 3 * np.pi * radius**3).sum() == pytest.approx(0.2 * np.pi * 49**2 * 98)


@pytest.mark.parametrize(
    "region",
    [
        {"type": "sphere", "radius": 5},
        {"type": "cylinder", "radius": 4, "length": 6},
        {"type": "box", "size": [4, 6, 8]},
    ],
    ids=lambda region: region["type"],
)
def test_places_are_spread_evenly_over_the_region(region):
    """The mean of the squared coordinates of a uniform body is known; the centres of small balls have it."""
    entry = {"count": 4000, "type": "sphere", "radius": 1e-6, "within": {**region, "center": [1, 2, 3]}}
    points = np.array([o["center"] for o in draw({"objects": [entry]}, refuse)["objects"]]) - [1, 2, 3]
    if region["type"] == "sphere":
        expected = np.full(3, 25 / 5)
    elif region["type"] == "cylinder":
        expected = np.array([16 / 4, 16 / 4, 36 / 12])
    else:
        expected = np.array(region["size"]) ** 2 / 12
    np.testing.assert_allclose((points**2).mean(axis=0), expected, rtol=0.06)
    assert np.abs(points.mean(axis=0)).max() < 0.15


@pytest.mark.parametrize("seed", range(3))
def test_the_preset_random_stays_inside_its_volume_and_its_panel(seed):
    from phantomgen.simulation.checks.field_of_view import coverage_warnings

    scan = load_scene("random", [f"seed={seed}", "geometry.views=24"])
    assert 4 <= len(scan.scene.objects) <= 13
    assert coverage_warnings(scan) == []
    assert scan.basis.names[:2] == ("photoelectric", "compton")
    body = scan.scene.objects[0][0]
    for shape, _ in scan.scene.objects[1:]:
        low, high = shape.bounds
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        ball = np.array(shape.center) + (corners - shape.center) / np.sqrt(3)  # on the ball inside the bounds
        assert body.contains(ball).all()


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("objects.0.radius={uniform: [9, 8]}", "uniform - needs two numbers [lowest, highest], got [9, 8]"),
        ("objects.0.radius={log_uniform: [0, 8]}", "log_uniform - needs two positive numbers"),
        ("objects.0.radius={normal: [1, 0]}", "normal - needs two numbers [mean, standard deviation]"),
        ("objects.0.radius={normal: [1, 2], least: 3}", "least - unknown key of normal"),
        ("objects.0.radius={normal: [1, 0.1], min: 99}", "with some of the distribution between them"),
        ("objects.0.radius={gaussian: [1, 2]}", "radius - unknown distribution 'gaussian'"),
        ("objects.0.radius={unifrom: [1, 2]}", "unknown distribution 'unifrom'; did you mean 'uniform'?"),
        ("objects.0.radius={uniform: 2}", "radius - uniform needs two numbers [lowest, highest], got 2"),
        ("objects.0.radius={uniform: [-2, -1]}", "objects.0.radius - input should be greater than 0, got -1."),
        ("objects.1.material={choice: []}", "choice - needs a list of at least one value"),
        ("objects.1.material={choice: [water, bonee]}", "objects.1.material - unknown material 'bonee'"),
        ("objects.1.count=-1", "count - must be a whole number of objects, 0 or more, got -1"),
        ("objects.1.count={uniform: [1, 2]}", "count - must be a whole number of objects"),
        ("objects.1.radius=8", "within - is 1 mm too small for an object that reaches 8 mm"),
        ("objects.1.gap=9", "of 12 objects: make them fewer or smaller"),
        ("objects.1.gap=-1", "gap - must be a distance in mm, 0 or more, got -1"),
        ("objects.1.fill=2", "fill - must be a part of the region's volume between 0 and 1, got 2"),
        ("objects.1.within={type: cone}", "within - must be a mapping with one of the types"),
        ("objects.1.within={type: [[1]], radius: 5}", "within - must be a mapping with one of the types"),
        ("objects.1.within={type: sphere, radius: 1" + "0" * 400 + "}", "within - of type sphere needs"),
        ("objects.1.within={type: sphere}", "within - of type sphere needs radius [mm]"),
        ("objects.1.center=[0, 0, 0]", "center - is drawn by within"),
        ("objects.1.type=mesh", "within - knows no size of a mesh"),
        ("objects.0.name=beads", "must be a text that no other object of the list has, got 'beads'"),
        ("seed={integers: [1, 9]}", "seed - must be a number"),
    ],
)
def test_mistakes_are_one_sentence_that_names_the_place(override, sentence):
    path = override.partition("=")[0]
    with pytest.raises(SceneError) as found:
        load_scene(toy(override))
    assert sentence in str(found.value)
    assert "\n" not in str(found.value)
    assert str(found.value).startswith(("--set ", "toy.yaml:"))
    assert path.split(".")[0] in str(found.value)


def test_mistakes_in_drawn_objects_name_line_and_column_of_the_file():
    text = SCENE.replace("{log_uniform: [0.1, 1]}", "{uniform: [-3, -2]}")
    with pytest.raises(SceneError, match=r"^toy.yaml:15:13: objects.1.radius - .*got -2\.\d+ \(object 0 of those"):
        load_scene(SceneFile("toy.yaml", text))
    text = SCENE + "  - {type: sphere, material: water, radius: -1}\n"
    with pytest.raises(SceneError, match=r"^toy.yaml:18:45: objects.2.radius - .*got -1$"):
        load_scene(SceneFile("toy.yaml", text))


def test_many_objects_are_written_line_by_line_and_read_back():
    file = toy("objects.1={name: dust, count: 1010, type: sphere, material: bone, radius: 0.01, center: [1, 2, 3]}")
    again = SceneFile("again.yaml", file.resolved)
    assert again.model == file.model
