"""Path lengths of a view through 4, 101 and 1001 shapes: time and error.

    python -m benchmarks.operators.trace_views

Prints, and writes to results/trace_views.txt beside this file. Errors are those of line integrals on 400 random pixels
against the float64 reference that sorts all surface crossings.
"""

import os
import platform
import time
from pathlib import Path

import numpy as np

from benchmarks.scenes.shape_scenes import ATTENUATION, SIDE, frames, shapes
from phantomgen.ops.trace import trace_view
from phantomgen.ops.trace.reference import trace_one
from phantomgen.shapes import solids_of
from spectra.threads import run_parallel, set_threads, thread_count

CURVES = np.array(ATTENUATION)[:, None]


def main() -> None:
    lines = [
        f"{platform.machine()}, {thread_count()} threads, {SIDE} x {SIDE} pixels, path lengths of 4 materials, "
        f"{os.getloadavg()[0]:.1f} processes busy before the start",
        "shapes   ms/view: one thread   all threads   line integral, worst error",
    ]
    for count in (4, 101, 1001):
        solids, rays = solids_of(shapes(count)), frames()

        def view(frame: np.ndarray, solids=solids):
            return trace_view(frame, SIDE, SIDE, solids, len(CURVES))

        view(rays[0])
        alone, every = [], []
        for _ in range(7):
            begin = time.thread_time()
            for frame in rays[:8]:
                view(frame)
            alone.append((time.thread_time() - begin) / 8)
            begin = time.perf_counter()
            list(run_parallel(view, rays))
            every.append((time.perf_counter() - begin) / len(rays))
        uv = np.random.default_rng(0).uniform(60, 196, (400, 2)).round().astype(int)
        directions = rays[1, 1] + uv @ rays[1, 2:]
        found = view(rays[1])[uv[:, 1], uv[:, 0]] @ CURVES
        exact = [trace_one(rays[1, 0], d, solids, len(CURVES)) @ CURVES for d in directions[: 400 if count < 9 else 40]]
        error = np.abs(found[: len(exact)] - exact).max()
        lines.append(f"{count:6d} {1e3 * min(alone):18.2f} {1e3 * min(every):15.2f} {error:20.1e}")
        print(lines[-1], flush=True)
    set_threads(None)
    (Path(__file__).parents[1] / "results" / "trace_views.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
