"""Compile the kernels of a simulation in a process of its own, while the caller reads its scene.

On a new machine a scan has some 15 s of kernels to compile. numba holds Python's lock meanwhile, so that a thread gains
nothing; another process does, and hands the result over in numba's cache on disk. Kernels that are not there when they
are needed are compiled where they are needed.
"""

import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Timer

import numpy as np

from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.expected_counts import Spectrum, expected_counts, expected_counts_by_grid
from phantomgen.ops.primitives import BALL
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace import trace
from phantomgen.ops.voxelize_shapes import fractions

# Seconds of compilation after which the user is told.
PATIENCE = 2.0


@contextmanager
def compiling_ahead(say: Callable[[str], None]) -> Iterator[Callable[[], None]]:
    """Compile kernels in another process while the body runs; a context manager.

    Parameters
    ----------
    say : called with a sentence when compilation takes longer than `PATIENCE`

    Yields
    ------
    function that waits for the kernels that the views require
    """
    command = [sys.executable, "-m", __name__]
    with subprocess.Popen(
        command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:

        def wait() -> None:
            hint = Timer(PATIENCE, say, ["Compiling kernels, once on this machine."])
            hint.start()
            if process.stdout is not None:
                process.stdout.readline()  # ends, too, when the process does
            hint.cancel()

        try:
            yield wait
        finally:
            process.terminate()


def _compile() -> None:
    """Run the smallest job through each operation, in the order in which a simulation requires them."""
    ball = Solids.plain(np.array([BALL]), np.eye(3, 4)[None], np.array([0]))
    spectrum = Spectrum(np.ones((1, 1)), np.ones(1), np.array([0, 1]))
    source, step = np.array([[0.0, -5.0, 0.0]]), np.array([[0.0, 10.0, 0.0]])
    frame = np.concatenate([source, step, np.eye(3)[[0, 2]]])
    trace(source, step, ball, 1)
    expected_counts(frame, 1, 1, ball, spectrum)
    sys.stdout.write("ready for views\n")
    sys.stdout.flush()
    fractions(Grid(shape=(1, 1, 1), spacing=(1.0, 1.0, 1.0), origin=(0.0, 0.0, 0.0)), ball, 1)
    expected_counts_by_grid(frame, np.array([[0, 0]]), ball, spectrum, n=1)


if __name__ == "__main__":
    _compile()
