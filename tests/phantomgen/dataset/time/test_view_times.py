"""Times of views: other divisions than the one stated, and cycles that are not there."""

import numpy as np
import pytest

from phantomgen.dataset.time.view_times import ViewTimes
from spectra.errors import InputError

TIMES = ViewTimes(np.arange(10.0), np.arange(10) % 2, 2, {"breath": np.arange(10) / 4 % 1})


def test_time_and_cycles_are_divided_into_other_phases():
    assert TIMES.divided(3).tolist() == [0, 0, 0, 1, 1, 1, 2, 2, 2, 2]
    assert TIMES.divided(4, "breath").tolist() == [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]
    assert TIMES.divided(2, "breath").tolist() == [0, 1, 1, 0, 0, 1, 1, 0, 0, 1]


def test_some_views_keep_their_times():
    some = TIMES[np.array([3, 1])]
    assert (some.time.tolist(), some.phase.tolist(), some.phases) == ([3, 1], [1, 1], 2)
    assert some.cycles["breath"].tolist() == [0.75, 0.25]


def test_an_unknown_cycle_is_refused_with_those_there_are():
    with pytest.raises(InputError, match="there is no cycle 'heart': choose from breath"):
        TIMES.divided(4, "heart")
