"""What a planned scan will take: time, memory and file size, from a few of its frames and slabs of its truth."""

import resource
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from phantomgen.dataset_layout import pack_image
from phantomgen.grid import Grid
from phantomgen.noise import Stream
from phantomgen.ops.expose import expose_brute
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.simulate_check import QUICK_PIXELS, SUB_RAYS
from phantomgen.simulate_views import Views
from spectra.threads import run_parallel, thread_count

T = TypeVar("T")
_SLABS = 4
# Rays of the sample that the cost of the final check is inferred from.
_CHECK_RAYS = 64


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
    """Run some frames, some slabs of the truth and a part of the check, and multiply.

    Parameters
    ----------
    views : the frames of the scan, with the settings of its plan
    """
    scan = views.scan
    view_time, view_bytes = _per_frame(views, Stream.PROJECTION, views.shape[0])
    flat_time, flat_bytes = _per_frame(views, Stream.FLAT, scan.flats)
    truth_time, truth_bytes = _truth(views)
    seconds = {
        "views": view_time * views.shape[0] + flat_time * scan.flats,
        "truth": truth_time,
        "check": _check_time(views),
    }
    size = view_bytes * views.shape[0] + flat_bytes * scan.flats + truth_bytes + _SMALL_PARTS
    return Cost(seconds, _memory(views), int(size))


# Geometry, spectra and notes of a file [byte].
_SMALL_PARTS = 200_000


def _per_frame(views: Views, stream: Stream, count: int) -> tuple[float, float]:
    """Seconds and bytes of one frame where all threads work."""

    def size(frame: int) -> int:
        images = views.measured(views.expected(frame, stream), frame, stream)
        return sum(len(chunk) for image in images for chunk in pack_image(image))

    chosen = np.linspace(0, count - 1, min(count, 2 * thread_count())).round().astype(int).tolist()
    size(chosen[0])  # whatever happens once only
    took, sizes = _timed(lambda: list(run_parallel(size, chosen)))
    return took / len(chosen), float(np.mean(sizes))


def _truth(views: Views) -> tuple[float, float]:
    """Seconds and bytes of the truth, from slabs of it."""
    scan, grid = views.scan, views.scan.grid
    depth, height, width = grid.shape
    layers = np.unique(np.linspace(0, depth - 1, min(_SLABS, depth)).round().astype(int)).tolist()
    count = len(scan.scene.materials)

    def packed(layer: int) -> int:
        origin = (grid.origin[0] + layer * grid.spacing[0], *grid.origin[1:])
        slab = Grid((1, height, width), grid.spacing, origin)
        filled = fractions(slab, scan.scene.solids, count, background=scan.scene.background)[:, 0]
        shares = sum(len(chunk) for image in filled for chunk in pack_image((image * 65535).astype(np.uint16)))
        mixed = filled.sum(axis=0).astype(np.float32)
        return shares + len(scan.basis) * sum(map(len, pack_image(mixed)))

    packed(layers[0])
    took, sizes = _timed(lambda: [packed(layer) for layer in layers])
    return took / len(layers) * depth, float(np.mean(sizes)) * depth


def _check_time(views: Views) -> float:
    """Seconds of the check after the run, from one pixel."""
    scan, t = views.scan, views.exposure.transmission
    frame, panel = scan.geometry.ray_frames()[0], scan.geometry.panel
    pixel = np.array([[panel.rows // 2, panel.columns // 2]])

    def brute() -> np.ndarray:
        solids, background = scan.scene.solids, scan.scene.background
        profile = None if scan.profile is None else scan.profile.lengths
        return expose_brute(
            frame, pixel, solids, t.columns, t.weights, t.starts, background, n=_CHECK_RAYS, profile=profile
        )

    brute()
    took, _ = _timed(brute)
    return took * (SUB_RAYS / _CHECK_RAYS) ** 2 * QUICK_PIXELS / thread_count()


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
