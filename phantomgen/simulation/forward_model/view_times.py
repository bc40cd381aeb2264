"""Times, phases and signals of the views, as a dataset states them."""

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.time.view_times import ViewTimes
from phantomgen.scene.dynamics.dynamics import Dynamics


def view_times(dynamics: Dynamics) -> tuple[ViewTimes, dict[str, Float[np.ndarray, " view"]]]:
    """Return what a gated scan records of time, and what only the truth knows.

    Parameters
    ----------
    dynamics : time of the scan

    Returns
    -------
    times, phases and cycles of the views, and the value of each signal at each view
    """
    cycles = {name: signal.cycles(dynamics.times) for name, signal in dynamics.signals.items()}
    recorded = ViewTimes(
        time=dynamics.times,
        phase=dynamics.phase_of_view,
        phases=1 if dynamics.phases is None else dynamics.phases.count,
        cycles={name: cycle for name, cycle in cycles.items() if cycle is not None},
    )
    return recorded, {name: signal.values(dynamics.times) for name, signal in dynamics.signals.items()}
