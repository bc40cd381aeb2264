"""A panel of one row measures a slice: objects may be longer than it sees, but not wider."""

from pathlib import Path

import pytest

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.field_of_view import coverage_warnings

SLICE = Path(__file__).parents[4] / "examples" / "switched_slice.yaml"


@pytest.mark.parametrize("orbit", [(), ("geometry={type: circular, sod: 500, sdd: 1000, views: 8}",)])
def test_objects_may_be_longer_than_a_slice(orbit: tuple[str, ...]) -> None:
    assert coverage_warnings(load_scene(SLICE, orbit)) == []


@pytest.mark.parametrize(
    ("columns", "size", "said"),
    [
        (256, 180, ["leaves the panel's field of view in 100% of the views sideways"]),
        (512, 120, ["reaches 10 mm beyond the volume"]),
    ],
)
def test_objects_may_not_be_wider_than_a_slice(columns: int, size: float, said: list[str]) -> None:
    found = coverage_warnings(load_scene(SLICE, (f"panel.columns={columns}", f"volume.size={size}")))
    assert len(found) == len(said)
    assert all(words in sentence for words, sentence in zip(said, found, strict=True))


def test_several_rows_tell_what_leaves_above_and_below() -> None:
    found = coverage_warnings(load_scene(SLICE, ("panel.rows=3", "volume.slices=3")))
    assert [sentence.split(":")[0] for sentence in found] == [
        *(f"object {i} ({name}) leaves the panel's field of view in 100% of the views" for i, name in NAMES),
        *(f"object {i} ({name}) reaches 18.9 mm beyond the volume" for i, name in NAMES),
    ]


NAMES = ((0, "adipose"), (1, "gland"))
