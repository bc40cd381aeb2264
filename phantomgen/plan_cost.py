"""What a planned scan will take: time, memory and file size, from a few of its frames and slabs of its truth."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from phantomgen.dataset_layout import pack_image
from phantomgen.noise import Stream
from phantomgen.simulate import streamed_truth
from phantomgen.simulate_views import Views
from spectra.threads import run_parallel, thread_count

T = TypeVar("T")
# Slabs of the truth that are tried, and slices of each.
_SLABS, _THICK = 4, 6


@dataclass(frozen=True)
class Cost:
    """What a scan will take, with as many threads as now.

    Parameters
    ----------
    seconds : per stage
    memory : largest resident memory of the process [byte]
    size : of the file [byte]
    """

    seconds: dict[str, float]
    memory: int
    size: int

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        total = sum(self.seconds.values())
        return {"seconds": {**self.seconds, "total": total}, "memory_bytes": self.memory, "file_bytes": self.size}

    @property
    def text(self) -> str:
        """For people."""
        stages = ", ".join(f"{name} {seconds:.2g} s" for name, seconds in self.seconds.items())
        return "\n".join(
            [
                f"time    about {sum(self.seconds.values()):.2g} s: {stages}",
                f"memory  about {self.memory / 2**30:.1f} GiB",
                f"file    about {self.size / 1e6:.3g} MB",
            ]
        )


def expected_cost(views: Views) -> Cost:
    """Run some frames and some slabs of the truth, and multiply.

    Parameters
    ----------
    views : the frames of the scan, with the settings of its plan
    """
    scan = views.scan
    view_time, view_bytes = _per_frame(views, Stream.PROJECTION, views.shape[0])
    flat_time, flat_bytes = _per_frame(views, Stream.FLAT, scan.flats)
    truth_time, truth_bytes = _truth(views)
    views_time = view_time * views.shape[0] + flat_time * scan.flats
    size = view_bytes * views.shape[0] + flat_bytes * scan.flats + truth_bytes + _SMALL_PARTS
    return Cost({"views": views_time, "truth": truth_time}, _memory(views), int(size))


# Geometry, spectra and notes of a file [byte].
_SMALL_PARTS = 200_000


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


def _memory(views: Views) -> int:
    """Memory that is in use now, and what frames on their way and the truth add."""
    frame = 8 * int(np.prod(views.shape[1:]))
    voxels = int(np.prod(views.scan.grid.shape))
    materials, bases = len(views.scan.scene.materials), len(views.scan.basis)
    unit = 1 if sys.platform == "darwin" else 1024
    now = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit
    return now + 3 * thread_count() * frame + voxels * (4 * materials + 2 * materials + 4 * bases + 2)


def _timed(task: Callable[[], T]) -> tuple[float, T]:
    """Seconds that a task takes, and its result."""
    began = time.perf_counter()
    result = task()
    return time.perf_counter() - began, result
