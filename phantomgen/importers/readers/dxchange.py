"""Data Exchange: projections, white and dark frames, and angles of a parallel beam.

Channels are files, or the groups ``exchange``, ``exchange1``, ``exchange2`` of one file.

References
----------
.. [1] De Carlo et al. 2014, doi:10.1107/S160057751401604X.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel
from phantomgen.importers.files.hdf5 import frame, frames_at, numbers_of, opened, readable, text_at, value_at
from phantomgen.importers.readers.channel_names import channel_names
from phantomgen.importers.readers.turntable import Turntable, as_stored, in_order, stated_axis, turning
from phantomgen.importers.scans.raw_scan import Frames, Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError

_GROUP = re.compile(r"exchange\d*$")
_PITCH = ("measurement/instrument/detector/pixel_size_{}", "measurement/instrument/detector/pixel_size")
_ENERGY = ("measurement/instrument/monochromator/energy", "process/acquisition/energy")
# Distance from the axis to the panel, which changes nothing in a parallel beam [mm].
_ANYWHERE = 100.0


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : files, one per channel, or one file
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When a file is damaged or lacks something.
    """
    groups = [group for path in paths for group in _groups(path)]
    stacks = [frames_at(group, "data") for group in groups]
    for group, stack in zip(groups, stacks, strict=True):
        if stack.ndim != 3 or stack.shape != stacks[0].shape:
            raise InputError(
                f"{group.file.filename}: {stack.name} has shape {stack.shape}, expected (view, row, column)"
                + (f" as {stacks[0].shape}" if stack.ndim == 3 else "")
            )
    first, (views, rows, columns) = groups[0], stacks[0].shape
    stated = stated.completed(_found(first.file))
    stated.require(paths[0], ["pitch"])
    if stated.sod is not None or stated.sdd is not None:
        raise InputError(f"{paths[0]}: Data Exchange is of parallel beams: leave --sod and --sdd out")
    angles = _angles(first, views)
    panel = Panel(rows, columns, stated.pitch or 0.0)
    table = Turntable(0.0, _ANYWHERE, panel).with_axis_at(stated_axis(stated, columns))

    def image(view: int) -> Image:
        return np.stack([frame(stack, view) for stack in stacks])

    white, dark = (_frames(groups, name) for name in ("data_white", "data_dark"))
    counted = stated.photons is None and stated.scintillator is None
    return RawScan(
        path=paths[0],
        title=text_at(first.file, "measurement/sample/name") or paths[0].stem,
        values="counts" if counted else "readings",
        channels=channel_names(paths) if len(paths) == len(groups) else tuple(f"bin{i}" for i in range(len(groups))),
        geometry=table.views(turning(-angles, stated)),
        image=as_stored(image, stated),
        stated=stated,
        flats=None if white is None else in_order(white, stated),
        darks=None if dark is None else in_order(dark, stated),
        notes=("the beam is parallel, as this format says",)
        + (
            () if not counted or stacks[0].dtype.kind in "iu" else ("values that are no integers were taken as counts",)
        ),
    )


def _groups(path: Path) -> list[h5py.Group]:
    """Groups that hold a channel."""
    file = opened(path)
    with readable(path):
        items = [file[name] for name in sorted(file) if _GROUP.match(name)]
        found = [item for item in items if isinstance(item, h5py.Group)]
    if not found:
        raise InputError(f"{path} has no group exchange: it is no Data Exchange file")
    return [group for group in found if "data" in group] or found[:1]


def _found(file: h5py.File) -> dict[str, object]:
    """Facts that a file states."""
    found: dict[str, object] = {}
    pitch = [value_at(file, *(name.format(axis) for name in _PITCH)) for axis in "yx"]
    if all(one is not None for one in pitch):
        found["pitch"] = tuple(float(numbers_of(one, "length", "um")[0]) for one in pitch if one is not None)
    energy = value_at(file, *_ENERGY)
    if energy is not None and energy.size == 1:
        found["energy"] = float(numbers_of(energy, "energy", "keV")[0])
    return found


def _angles(group: h5py.Group, views: int) -> Float[np.ndarray, " view"]:
    """Angles of the sample [degree]."""
    array = value_at(group, "theta")
    if array is not None:
        angles = numbers_of(array, "angle", "degree")
    else:
        place = "process/acquisition/rotation"
        start, step = (value_at(group.file, f"{place}/rotation_{name}") for name in ("start", "step"))
        if start is None or step is None:
            raise InputError(f"{group.file.filename}: {group.name}/theta is missing, and so is {place}")
        first, by = (float(numbers_of(one, "angle", "degree")[0]) for one in (start, step))
        angles = first + by * np.arange(views)
    if len(angles) != views:
        raise InputError(f"{group.file.filename}: {group.name}/theta has {len(angles)} angles for {views} views")
    return angles


def _frames(groups: Sequence[h5py.Group], name: str) -> Frames | None:
    """White or dark frames of all channels; as many of each as the shortest stack has."""
    if any(value_at(group, name) is None for group in groups):
        return None
    stacks = [frames_at(group, name) for group in groups]
    count = min(len(stack) for stack in stacks)
    return np.stack([np.stack([frame(stack, n) for n in range(count)]) for stack in stacks], axis=1)
