"""Single Compton scatter: error and time of a view by cells of the volume and places of the panel.

    python -m benchmarks.simulator.scatter [PRESET]

Errors are relative to the scattered signal with 24 cells and 11 places, each channel for itself: rms and largest over
all pixels of a view, of the channel with the largest error and of the one with the smallest. Times are the least of
three; the view without scatter took as long as the last line says.
"""

import sys
import time

import numpy as np

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.discretization import Settings
from phantomgen.simulation.forward_model.expected_counts import expected_view
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from phantomgen.simulation.forward_model.scatter import SingleScatter

VIEW = 3


def least_time(task) -> tuple[np.ndarray, float]:
    """Result, and the shortest of three runs [ms]."""
    times = []
    for _ in range(3):
        began = time.perf_counter()
        result = task()
        times.append(time.perf_counter() - began)
    return result, min(times) * 1e3


def main(preset: str) -> None:
    scan = load_scene(preset, ["effects.scatter={type: compton}"])
    exposure, _ = Exposure.of(scan, sampled_lengths(scan), 1e-5)
    exact = SingleScatter.of(scan, exposure, Settings(scatter=(24, 11))).view(VIEW)
    print(f"{'cells':>6}{'places':>8}{'points':>8}{'rms':>18}{'largest':>18}{'ms/view':>9}")
    for cells, places in ((6, 5), (8, 5), (12, 5), (12, 7), (16, 5), (16, 7)):
        model = SingleScatter.of(scan, exposure, Settings(scatter=(cells, places)))
        found, took = least_time(lambda model=model: model.view(VIEW))
        error = found / exact - 1
        rms, worst = np.sqrt((error**2).mean(axis=(1, 2))), np.abs(error).max(axis=(1, 2))
        spans = [f"{values.min():.1%} .. {values.max():.1%}" for values in (rms, worst)]
        print(f"{cells:>6}{places:>8}{len(model.place):>8}{spans[0]:>18}{spans[1]:>18}{took:>9.0f}", flush=True)
    primary, took = least_time(lambda: expected_view(scan, exposure.groups, VIEW, Settings()))
    ratio = (exact.sum(axis=(1, 2)) / primary.sum(axis=(1, 2))).round(3)
    print(f"primary: {took:.0f} ms per view; scatter over primary, summed over the panel: {ratio.tolist()}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "kedge")
