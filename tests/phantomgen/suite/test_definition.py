"""Definitions of suites: v1 never changes, and its scenes are physical and distinct."""

import numpy as np
import pytest
from support.tiny_suite import DEFINITION, definitions

from phantomgen.scene.scan import load_scene
from phantomgen.suite.definition import read_suite, suite_names
from spectra.errors import InputError

# What results on the suite cite. A test that fails here says that v1 became another suite: name the new one v2.
V1 = {
    "minutes": "f41f1bb44e7fd8257fbe229e27e718c56d8428b6a807b6cca0422aeaff94269a",
    "hour": "72761df7eeab523c6a85e5cca1dcfb2fba7da1356ccdb4d372e4236487f5e1af",
    "night": "81a515322dc0a2ffa037da9a545c75ff3807a49e1c5d40dac1b4abc8c1525f12",
}
CASES = ["k-edge", "sparse-views", "low-dose", "truncated", "metal", "two-agents", "wrong-spectrum", "anatomy"]


@pytest.mark.parametrize(("tier", "digest"), V1.items())
def test_v1_is_what_results_cite(tier, digest):
    suite = read_suite("v1", tier)
    assert suite.sha256 == digest
    assert [case.name for case in suite.cases] == CASES
    assert len({case.sha256 for case in suite.cases}) == len(CASES)
    assert {case.name: case.sha256 for case in suite.cases} == {n: e["scene"] for n, e in suite.expected.items()}


def test_a_tier_keeps_field_of_view_and_scales_voxels_pixels_and_views():
    for small, large in zip(read_suite("v1", "minutes").cases, read_suite("v1", "night").cases, strict=True):
        few, many = load_scene(small.scene), load_scene(large.scene)
        assert (few.grid.shape, many.grid.shape) == ((48,) * 3, (128,) * 3), small.name
        widths = [scan.geometry.panel.columns * scan.geometry.panel.pitch[1] for scan in (few, many)]
        assert widths[0] == pytest.approx(widths[1], rel=0.02), small.name
        views = [len(scan.geometry) - 12 for scan in (few, many)]
        assert views[0] == views[1] * 3 / 8, small.name


def test_cases_of_one_object_differ_in_one_thing():
    cases = {case.name: case for case in read_suite("v1", "night").cases}
    plain = cases["k-edge"].scene.values

    def changes(name: str) -> set[str]:
        values = cases[name].scene.values
        return {key for key in plain if values[key] != plain[key]} - {"seed"}

    assert changes("sparse-views") == {"geometry"}
    assert changes("low-dose") == {"source"}
    assert changes("truncated") == changes("wrong-spectrum") == set()
    assert cases["truncated"].degradation.truncate == 0.4
    assert cases["wrong-spectrum"].degradation.kv_error == -20
    seeds = [case.scene.values["seed"] for case in cases.values()]
    assert len(set(seeds)) == len(seeds)


def test_vials_of_two_agents_lie_apart_within_the_water():
    scene = read_suite("v1", "minutes").cases[CASES.index("two-agents")].scene
    water, *vials = scene.values["objects"]
    centres = np.array([vial["center"][:2] for vial in vials])
    radii = np.array([vial["radius"] for vial in vials])
    assert (np.hypot(*centres.T) + radii < water["radius"]).all()
    apart = np.linalg.norm(centres[:, None] - centres[None], axis=-1)[np.triu_indices(len(vials), 1)]
    assert apart.min() > 2 * radii.max()
    assert len({vial["material"] for vial in vials}) == len(vials) == 9


def test_comments_do_not_change_the_hash_and_numbers_do(monkeypatch, tmp_path):
    digests = []
    for text in (DEFINITION, "# said otherwise\n" + DEFINITION, DEFINITION.replace("kv_error: 10", "kv_error: 11")):
        definitions(monkeypatch, tmp_path, text)
        digests.append(read_suite("tiny", "minutes").sha256)
    assert digests[0] == digests[1] != digests[2]


def test_what_does_not_exist_is_named():
    assert suite_names() == ("v1",)
    with pytest.raises(InputError, match=r"there is no suite 'v2': choose from v1"):
        read_suite("v2", "minutes")
    with pytest.raises(InputError, match=r"the suite v1 has no tier 'week': choose from minutes, hour, night"):
        read_suite("v1", "week")
