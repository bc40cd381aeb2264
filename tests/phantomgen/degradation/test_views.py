"""Which views are left."""

import numpy as np
import pytest

from phantomgen.degradation.views import evenly_spread, renumbered, within_arc
from spectra.errors import InputError

ANGLES = np.deg2rad(np.arange(12) * 30.0)
ALL = np.arange(12)


@pytest.mark.parametrize(
    ("angles", "arc", "left"),
    [
        (ANGLES, (0, 120), [0, 1, 2, 3]),
        (ANGLES, (30, 150), [1, 2, 3, 4]),
        (ANGLES, (0, 360), list(range(12))),
        (ANGLES + 0.3, (0, 90), [0, 1, 2]),
        (-ANGLES, (0, 90), [0, 1, 2]),
        (np.angle(np.exp(1j * (ANGLES + 3.0))), (0, 90), [0, 1, 2]),
    ],
)
def test_an_arc_begins_at_the_first_view_and_excludes_its_end(angles, arc, left):
    assert within_arc(ALL, angles, arc, helical=False).tolist() == left


def test_a_helix_counts_turns():
    assert within_arc(ALL, 3 * ANGLES, (0, 400), helical=True).tolist() == [0, 1, 2, 3, 4]
    assert within_arc(ALL, 3 * ANGLES, (0, 90), helical=False).tolist() == [0, 4, 8]


def test_an_arc_without_views_and_views_without_angles_are_refused():
    with pytest.raises(InputError, match=r"the arc 31:59 holds no training view: they lie from 0 to 330 degrees"):
        within_arc(ALL, ANGLES, (31, 59), helical=False)
    with pytest.raises(InputError, match="free poses"):
        within_arc(ALL, np.full(12, np.nan), (0, 90), helical=False)


def test_views_are_evenly_spread():
    assert evenly_spread(ALL, 4).tolist() == [0, 3, 6, 9]
    assert evenly_spread(ALL, 12).tolist() == ALL.tolist()
    with pytest.raises(InputError, match="there are 12 training views to choose from: 13 cannot be used"):
        evenly_spread(ALL, 13)


def test_splits_name_the_same_views_as_before():
    splits = {"train": np.arange(0, 8), "test": np.array([8, 10]), "val": np.array([9])}
    kept, new = renumbered(splits, np.array([1, 5]))
    assert kept.tolist() == [1, 5, 8, 9, 10]
    assert {name: kept[views].tolist() for name, views in new.items()} == {"train": [1, 5], "test": [8, 10], "val": [9]}
