"""The pool that all kernels share."""

import threading

import pytest

from spectra.threads import run_parallel, set_threads


@pytest.fixture(params=[1, 2, 3])
def threads(request):
    set_threads(request.param)
    yield request.param
    set_threads(None)


def test_results_come_in_order(threads):
    del threads
    assert list(run_parallel(lambda n: n * n, range(20))) == [n * n for n in range(20)]


def test_tasks_that_share_out_work_in_turn_come_to_an_end(threads):
    """All threads would wait for pieces that none of them is free to take."""

    def outer(n):
        return sum(run_parallel(lambda m: n * m, range(5)))

    found = []
    asking = threading.Thread(target=lambda: found.extend(run_parallel(outer, range(4 * threads))), daemon=True)
    asking.start()
    asking.join(timeout=30)
    assert not asking.is_alive()
    assert found == [10 * n for n in range(4 * threads)]
