"""Which models count for a budget, with a clock that tests turn by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from recon.comparison.contenders import clock as clocks
from recon.comparison.contenders.clock import BudgetSpent, Clock
from recon.comparison.contenders.recorder import Recorder


@pytest.fixture
def hand(monkeypatch):
    """Seconds that a test may change."""
    now = {"seconds": 100.0}
    monkeypatch.setitem(clocks.CLOCKS, "hand", lambda: now["seconds"])
    return now


def test_a_clock_stands_still_while_results_are_kept(hand):
    clock = Clock("hand")
    clock.start()
    hand["seconds"] += 3
    with clock.paused() as seconds:
        hand["seconds"] += 50
        assert seconds == 3
    hand["seconds"] += 2
    assert clock.seconds() == 5
    clock.stop()
    hand["seconds"] += 9
    assert clock.seconds() == 5
    clock.start(at=1.0)
    hand["seconds"] += 4
    assert clock.seconds() == 5


def test_a_clock_that_was_stopped_does_not_run_after_a_pause(hand):
    clock = Clock("hand")
    with clock.paused():
        hand["seconds"] += 1
    hand["seconds"] += 1
    assert clock.seconds() == 0


def eighths(low, high):
    """Seconds whose sums are exact."""
    return st.integers(8 * low, 8 * high).map(lambda n: n / 8)


@given(
    ends=st.lists(eighths(1, 100), min_size=1, max_size=40).map(sorted),
    budgets=st.lists(eighths(1, 90), min_size=1, max_size=4, unique=True),
)
def test_the_last_model_within_each_budget_is_kept_and_few_others(tmp_path_factory, ends, budgets):
    folder, now = tmp_path_factory.mktemp("models"), {"seconds": 0.0}
    clock = Clock("wall")
    clock._now = lambda: now["seconds"]
    recorder = Recorder(clock, folder, budgets)
    clock.start()
    for i, end in enumerate(ends):
        now["seconds"] = end
        try:
            recorder.add(i + 1, len(ends), lambda path, text=str(end): path.write_text(text))
        except BudgetSpent:
            assert end > max(budgets)
            break
    for budget in budgets:
        expected = max((end for end in ends if end <= budget), default=None)
        found = recorder.result(budget)
        assert (None if found is None else found.seconds) == expected
        assert found is None or found.path.read_text() == str(expected)
    assert {model.path for model in recorder.recorded} == set(folder.iterdir())


def test_a_method_that_passes_its_budget_is_stopped(tmp_path, hand):
    clock = Clock("hand")
    recorder = Recorder(clock, tmp_path, [2.0])
    clock.start()
    hand["seconds"] += 1
    recorder.add(1, 9, lambda path: path.write_text(""))
    hand["seconds"] += 1.5
    with pytest.raises(BudgetSpent):
        recorder.add(2, 9, lambda path: path.write_text(""))
    assert recorder.result(2.0).done == 1
    assert not recorder.is_final(recorder.result(2.0))
