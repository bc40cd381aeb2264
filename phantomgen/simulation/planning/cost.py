"""Cost of a planned scan: time, memory and file size, estimated from some frames and slabs of the truth."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from phantomgen.dataset.layout import pack_image
from phantomgen.effects.random_streams import Stream
from phantomgen.runtime.stopwatch import peak_memory_mib
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.truth import streamed_truth
from spectra.threads import run_parallel, thread_count

T = TypeVar("T")
# Geometry, spectra and notes of a file [byte].
_SMALL_PARTS = 200_000
# Bytes per voxel of a slab and material (float32, then uint16), and basis (float32).
_SHARE, _VOLUME = 6, 4
# Slabs of the truth that are tried, and slices of each.
_SLABS, _THICK = 4, 6


@dataclass(frozen=True)
class Cost:
    """Estimated cost of a scan, with the current number of threads.

    Parameters
    ----------
    seconds : per stage
    memory : largest resident memory of the process [MiB], None where the system does not tell
    size : of the file [byte]
    """

    seconds: dict[str, float]
    memory: float | None
    size: int

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        total = sum(self.seconds.values())
        return {"seconds": {**self.seconds, "total": total}, "memory_mib": self.memory, "file_bytes": self.size}

    @property
    def text(self) -> str:
        """Cost as text."""
        stages = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in self.seconds.items())
        memory = [] if self.memory is None else [f"memory  about {self.memory:.0f} MiB"]
        total = sum(self.seconds.values())
        return "\n".join([f"time    about {total:.2g} s: {stages}", *memory, f"file    about {self.size / 1e6:.3g} MB"])


def expected_cost(views: Views) -> Cost:
    """Estimate the cost of a scan from some frames and some slabs of the truth.

    Parameters
    ----------
    views : the frames of the scan, with the settings of its plan

    Returns
    -------
    time, memory and file size
    """
    scan = views.scan
    view_time, view_bytes = _per_frame(views, Stream.PROJECTION, views.shape[0])
    flat_time, flat_bytes = _per_frame(views, Stream.FLAT, scan.flats)
    truth_time, truth_bytes = _truth(views)
    views_time = view_time * views.shape[0] + flat_time * scan.flats
    size = view_bytes * views.shape[0] + flat_bytes * scan.flats + truth_bytes + _SMALL_PARTS
    return Cost({"views": views_time, "truth": truth_time}, expected_memory(views), int(size))


def _per_frame(views: Views, stream: Stream, count: int) -> tuple[float, float]:
    """Seconds and bytes of one frame where all threads work."""

    def size(frame: int) -> int:
        images = views.read(views.registered(views.expected(frame, stream), frame, stream), frame, stream)
        return sum(len(chunk) for image in images for chunk in pack_image(image))

    chosen = np.linspace(0, count - 1, min(count, 2 * thread_count())).round().astype(int).tolist()
    size(chosen[0])  # whatever happens once only
    took, sizes = _timed(lambda: list(run_parallel(size, chosen)))
    return took / len(chosen), float(np.mean(sizes))


def _truth(views: Views) -> tuple[float, float]:
    """Seconds and bytes of the truth, from thin and thick slabs of it, as each slab takes a while to begin."""
    truth = streamed_truth(views.scan)
    depth, step = truth.grid.shape[0], truth.slab
    thick = min(_THICK, depth)
    firsts = np.unique(np.linspace(0, depth - thick, _SLABS).round().astype(int)).tolist()

    def packed(first: int, slices: int) -> int:
        part = truth.part(truth.grid.slices(first, slices))
        shape = part.grid.shape[1:]
        images = [*part.volumes.reshape(-1, *shape), *part.labels, *part.fractions.reshape(-1, *shape)]
        return sum(map(len, run_parallel(lambda image: b"".join(pack_image(image)), images)))

    packed(firsts[0], 1)
    thin_time, _ = _timed(lambda: [packed(first, 1) for first in firsts])
    took, sizes = _timed(lambda: [packed(first, thick) for first in firsts])
    per_slice = max(took - thin_time, 0.0) / (len(firsts) * max(thick - 1, 1))
    begin = max(thin_time / len(firsts) - per_slice, 0.0)
    return begin * -(-depth // step) + per_slice * depth, float(np.mean(sizes)) / thick * depth


def expected_memory(views: Views) -> float | None:
    """Estimate the memory of a scan: memory in use, frames in work and a slab of the truth.

    Parameters
    ----------
    views : the frames of the scan

    Returns
    -------
    memory [MiB]; None where the system does not tell
    """
    known = peak_memory_mib()
    if known is None:
        return None
    truth = streamed_truth(views.scan)
    depth, rows, columns = truth.grid.shape
    voxels = min(truth.slab, depth) * rows * columns
    materials, bases = len(views.scan.scene.materials), len(views.scan.basis)
    frames = 3 * thread_count() * 8 * int(np.prod(views.shape[1:]))
    return known + (frames + voxels * (_SHARE * materials + _VOLUME * bases)) / 2**20


def _timed(task: Callable[[], T]) -> tuple[float, T]:
    """Seconds that a task takes, and its result."""
    began = time.perf_counter()
    result = task()
    return time.perf_counter() - began, result
