"""Times and phases of the views in ``/entry/time``, as a gated scan records them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import h5py
import numpy as np
from jaxtyping import Float, Int

from phantomgen.dataset.checks.door import group_at, has, value_at
from phantomgen.dataset.layout import new_group, put, text_of
from spectra.errors import InputError


@dataclass(frozen=True, eq=False)
class ViewTimes:
    """Times of the views.

    Parameters
    ----------
    time : of each view [s]
    phase : of each view, from 0; None where views are not divided
    phases : number of phases, 1 where views are not divided
    cycles : position in the cycle at each view, from 0 to 1, of breathing, heartbeat and the like by name
    """

    time: Float[np.ndarray, " view"]
    phase: Int[np.ndarray, " view"] | None = None
    phases: int = 1
    cycles: Mapping[str, Float[np.ndarray, " view"]] = field(default_factory=dict)

    def divided(self, count: int, by: str | None = None) -> Int[np.ndarray, " view"]:
        """Divide the views into another number of phases.

        Parameters
        ----------
        count : number of phases
        by : name of the cycle; None for equal parts of the time

        Returns
        -------
        phase of each view; phases of a cycle are centred at 0, 1 / count, 2 / count ... of it

        Raises
        ------
        InputError
            When there is no such cycle.
        """
        if by is None:
            first, last = self.time.min(), self.time.max()
            length = (last - first) or 1.0
            return np.minimum((self.time - first) / length * count, count - 1).astype(np.int64)
        if by not in self.cycles:
            known = f"choose from {', '.join(self.cycles)}" if self.cycles else "the scan has none"
            raise InputError(f"there is no cycle {by!r}: {known}")
        return np.floor(self.cycles[by] * count + 0.5).astype(np.int64) % count

    def __getitem__(self, views: Int[np.ndarray, " _view"]) -> "ViewTimes":
        """Return the times of some views."""
        phase = None if self.phase is None else self.phase[views]
        return ViewTimes(self.time[views], phase, self.phases, {n: c[views] for n, c in self.cycles.items()})


def write_view_times(entry: h5py.Group, times: ViewTimes) -> None:
    """Write ``/entry/time``.

    Parameters
    ----------
    entry : group of the scan
    times : of the views
    """
    group = new_group(entry, "time", "NXcollection")
    put(group, "time", times.time, "s")
    if times.phase is not None:
        put(group, "phase", times.phase.astype(np.int32))
        put(group, "phases", np.int32(times.phases))
    if times.cycles:
        put(group, "cycle_name", np.array(list(times.cycles), dtype=object))
        put(group, "cycle", np.stack(list(times.cycles.values())))


def read_view_times(file: h5py.File) -> ViewTimes | None:
    """Read ``/entry/time``.

    Parameters
    ----------
    file : open dataset

    Returns
    -------
    the times; None where the file has none
    """
    if not has(file, "entry/time"):
        return None
    group = group_at(file, "entry/time")
    phase = value_at(group, "phase").astype(np.int64) if has(group, "phase") else None
    names = [text_of(name) for name in value_at(group, "cycle_name")] if has(group, "cycle_name") else []
    cycles = dict(zip(names, value_at(group, "cycle"), strict=True)) if names else {}
    return ViewTimes(value_at(group, "time"), phase, 1 if phase is None else int(value_at(group, "phases")), cycles)
