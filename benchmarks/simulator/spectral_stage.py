"""Path lengths in all materials to counts of five channels: time and error by the number of energy nodes.

    python -m benchmarks.simulator.spectral_stage

Prints, and writes to results/spectral_stage.txt beside this file. Nodes are those that a tolerance chooses for a tube
of 120 kVp and a photon-counting detector of five channels; errors are those of log counts against bins of 0.05 keV.
"""

import os
import platform
import time
from pathlib import Path

import numpy as np

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import compressed_transmission, fine_transmission
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths
from spectra.ops.transmit import expected_counts
from spectra.threads import thread_count

SIDE = 256
CHANGES = ["detector.thresholds=[25, 33.2, 50, 63.3, 80]"]


def main() -> None:
    scan = load_scene("kedge-physical", CHANGES)
    sampled = sampled_lengths(scan)
    rng = np.random.default_rng(0)
    lengths = sampled[rng.integers(len(sampled), size=SIDE * SIDE)]
    exact = fine_transmission(scan, step=0.05)
    few = lengths[:3000]
    truth = exact.expected(few) / exact.open_beam
    lines = [
        f"{platform.machine()}, {thread_count()} threads, {SIDE} x {SIDE} rays, {lengths.shape[1]} materials, "
        f"{len(exact)} channels, {os.getloadavg()[0]:.1f} processes busy before the start",
        "tolerance   nodes   ms: one thread's processor   all threads   log error: rms, worst",
    ]
    for tolerance in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6):
        found, _ = compressed_transmission(scan, sampled, tolerance=tolerance)
        arrays = (found.columns, found.weights, found.starts)
        one, every = [], []
        for _ in range(9):
            begin = time.perf_counter()
            expected_counts(lengths, *arrays)
            every.append(time.perf_counter() - begin)
            begin = time.thread_time()
            for first in range(0, len(lengths), 16384):  # pieces of this size stay on this thread
                expected_counts(lengths[first : first + 16384], *arrays)
            one.append(time.thread_time() - begin)
        error = np.log(found.expected(few) / found.open_beam / truth)
        lines.append(
            f"{tolerance:9.0e} {len(found.weights):7d} {1e3 * min(one):28.2f} {1e3 * min(every):13.2f}"
            f" {np.sqrt((error**2).mean()):14.1e} {np.abs(error).max():8.1e}"
        )
        print(lines[-1], flush=True)
    (Path(__file__).parents[1] / "results" / "spectral_stage.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
