"""NXtomo: flats, projections and darks in one stack per channel, by keys; angles and distances.

Channels are entries of one file, files, or a second axis of the stack (frame, channel, row, column).

References
----------
.. [1] NeXus definitions, NXtomo: https://manual.nexusformat.org/classes/applications/NXtomo.html.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import h5py
import numpy as np
from jaxtyping import Float, Int64

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.importers.files.hdf5 import frame, frames_at, numbers_of, opened, readable, text_at, value_at
from phantomgen.importers.readers.channel_names import channel_names, clean
from phantomgen.importers.readers.turntable import Turntable, as_stored, in_order, stated_axis, turning
from phantomgen.importers.scans.raw_scan import Frames, Image, RawScan
from phantomgen.importers.scans.stated import Stated
from spectra.errors import InputError

_PROJECTION, _FLAT, _DARK = 0, 1, 2
_ALIGNMENT = -1  # of image_key_control: views taken again to see whether the sample moved
_DETECTOR = "instrument/detector"
# Distance from the axis to the panel in a parallel beam, where it changes nothing [mm].
_ANYWHERE = 100.0
_SHIFTED = 1e-6  # mm


class _Entry(NamedTuple):
    """One channel, or several along the second axis of its stack."""

    path: Path
    group: h5py.Group
    stack: h5py.Dataset
    keys: Int64[np.ndarray, " frame"]

    def frames(self, key: int) -> Int64[np.ndarray, " frame"]:
        """Numbers of the frames of one kind."""
        return np.flatnonzero(self.keys == key)


def read(paths: Sequence[Path], stated: Stated) -> RawScan:
    """Read a scan.

    Parameters
    ----------
    paths : files, each with one entry or more
    stated : facts that the user states

    Returns
    -------
    the scan

    Raises
    ------
    InputError
        When a file is damaged, lacks something, or says something that cannot be expressed.
    """
    entries = [entry for path in paths for entry in _entries(path)]
    first = entries[0]
    for other in entries[1:]:
        if other.stack.shape[1:] != first.stack.shape[1:] or not np.array_equal(other.keys, first.keys):
            raise InputError(
                f"{other.path}: {other.group.name} has other frames than {first.group.name} of {first.path}: channels "
                "of one scan have the same views, flats and darks"
            )
    stated = stated.completed(_found(first))
    stated.require(first.path, ["pitch"])
    geometry, notes = _geometry(first, stated)
    views = first.frames(_PROJECTION)

    def channels(number: int) -> Image:
        images = [frame(entry.stack, number) for entry in entries]
        return np.concatenate([image.reshape(-1, *image.shape[-2:]) for image in images])

    def frames(key: int) -> Frames | None:
        numbers = first.frames(key)
        return in_order(np.stack([channels(int(n)) for n in numbers]), stated) if len(numbers) else None

    names = _names(entries, paths)
    integer = all(entry.stack.dtype.kind in "iu" for entry in entries)
    return RawScan(
        path=first.path,
        title=text_at(first.group, "title", "sample/name") or first.path.stem,
        values="counts" if stated.photons is None and stated.scintillator is None else "readings",
        channels=names,
        geometry=geometry,
        image=as_stored(lambda view: channels(int(views[view])), stated),
        stated=stated,
        flats=frames(_FLAT),
        darks=frames(_DARK),
        exposure=_exposure(entries, len(names)),
        notes=(*notes, *(() if integer or stated.photons else ("values that are no integers were taken as counts",))),
    )


def _entries(path: Path) -> list[_Entry]:
    """Entries of a file that are NXtomo."""
    file = opened(path)
    with readable(path):
        groups = [item for item in file.values() if isinstance(item, h5py.Group)]
    found = [group for group in groups if (text_at(group, "definition") or "").lower() == "nxtomo"]
    if not found:
        raise InputError(f"{path} has no entry whose definition is NXtomo")
    return [_entry(path, group) for group in found]


def _entry(path: Path, group: h5py.Group) -> _Entry:
    """The stack of an entry and its keys."""
    stack = frames_at(group, f"{_DETECTOR}/data")
    count = stack.shape[0]
    array = value_at(group, f"{_DETECTOR}/image_key")
    keys = np.zeros(count) if array is None else numbers_of(array, "number", "")
    control = value_at(group, f"{_DETECTOR}/image_key_control")
    if len(keys) != count:
        raise InputError(f"{path}: {group.name} has {count} frames and {len(keys)} values of image_key")
    if control is not None:
        again = numbers_of(control, "number", "")
        if len(again) == count:
            keys = np.where(again == _ALIGNMENT, _ALIGNMENT, keys)
    if not (keys == _PROJECTION).any():
        raise InputError(f"{path}: {group.name} has no projections: no value of image_key is 0")
    return _Entry(path, group, stack, keys.astype(np.int64))


def _names(entries: Sequence[_Entry], paths: Sequence[Path]) -> tuple[str, ...]:
    """Names of the channels: of files, of entries, or numbers."""
    if len(entries) == 1:
        stack = entries[0].stack
        count = stack.shape[1] if stack.ndim == 4 else 1
        return ("signal",) if count == 1 else tuple(f"bin{i}" for i in range(count))
    if any(entry.stack.ndim == 4 for entry in entries):
        raise InputError(f"{entries[0].path}: several entries and a stack with an axis of channels: give one of them")
    if len(paths) == len(entries):
        return channel_names(paths)
    return tuple(clean(str(entry.group.name).removeprefix("/nxtomo_")) for entry in entries)


def _found(entry: _Entry) -> dict[str, object]:
    """Facts that an entry states."""
    pitch = [value_at(entry.group, f"{_DETECTOR}/{axis}_pixel_size") for axis in "yx"]
    energy = value_at(entry.group, "instrument/beam/incident_energy", "beam/incident_energy", "instrument/beam/energy")
    voltage = value_at(entry.group, "instrument/source/voltage")
    before = value_at(entry.group, "instrument/source/distance")
    behind = value_at(entry.group, f"{_DETECTOR}/distance")
    found: dict[str, object] = {}
    if all(one is not None for one in pitch):
        row, column = (float(numbers_of(one, "length", "m")[0]) for one in pitch if one is not None)
        if min(row, column) <= 0:
            raise InputError(f"{entry.path}: the pixel size must be positive, got {row:g} x {column:g} mm")
        found["pitch"] = (row, column)
    if voltage is not None:
        found["kvp"] = float(np.ravel(voltage[()])[0])
    elif energy is not None and energy.size == 1 and before is None:
        found["energy"] = float(numbers_of(energy, "energy", "keV")[0])
    if before is not None and behind is not None:
        sod = abs(float(numbers_of(before, "length", "m")[0]))
        found |= {"sod": sod, "sdd": sod + abs(float(numbers_of(behind, "length", "m")[0]))} if sod else {}
    return found


def _geometry(entry: _Entry, stated: Stated) -> tuple[Geometry, list[str]]:
    """Poses: the sample turns by an angle as the source turns by its opposite."""
    views, notes = entry.frames(_PROJECTION), []
    _, rows, columns = (entry.stack.shape[0], *entry.stack.shape[-2:])
    angles = _per_view(entry, "sample/rotation_angle", "angle", "degree", views)
    if angles is None:
        raise InputError(f"{entry.path}: {entry.group.name}/sample/rotation_angle is missing")
    panel = Panel(rows, columns, stated.pitch or 0.0)
    table = Turntable(stated.sod or 0.0, stated.sdd or 0.0, panel)
    if stated.sod is None:
        table = Turntable(0.0, _ANYWHERE, panel)
        notes.append("no distance from the source: the beam was taken as parallel; --sod and --sdd state a cone")
    elif stated.sdd is None:
        stated.require(entry.path, ["sdd"])
    axis = value_at(entry.group, f"{_DETECTOR}/x_rotation_axis_pixel_position")
    column = stated_axis(stated, columns)
    if column is None and axis is not None:
        column = (columns - 1) / 2 + float(numbers_of(axis, "number", "")[0])
    for name in ("x_translation", "y_translation"):
        shifts = _per_view(entry, f"sample/{name}", "length", "m", views)
        if shifts is not None and np.ptp(shifts) > _SHIFTED:
            raise InputError(
                f"{entry.path}: sample/{name} changes by {np.ptp(shifts):.4g} mm, and only z_translation, along the "
                "rotation axis, may"
            )
    heights = _per_view(entry, "sample/z_translation", "length", "m", views)
    moved = heights is not None and np.ptp(heights) > _SHIFTED
    z = -(heights - (heights.min() + heights.max()) / 2) if heights is not None and moved else 0.0
    if f"{_DETECTOR}/transformations" in entry.group:
        notes.append("flips in detector/transformations are not applied: --mirror and --flip-rows do")
    return table.with_axis_at(column).views(turning(-angles, stated), z), notes


def _per_view(
    entry: _Entry, name: str, kind: str, default: str, views: Int64[np.ndarray, " view"]
) -> Float[np.ndarray, " view"] | None:
    """Numbers of the projections, from those of all frames or of one for all."""
    array = value_at(entry.group, name)
    if array is None:
        return None
    values, count = numbers_of(array, kind, default), len(entry.keys)
    if len(values) == count:
        return values[views]
    if len(values) in (1, len(views)):
        return np.broadcast_to(values, views.shape).copy()
    raise InputError(f"{entry.path}: {entry.group.name}/{name} has {len(values)} values for {count} frames")


def _exposure(entries: Sequence[_Entry], channels: int) -> Float[np.ndarray, "view channel"] | None:
    """Output of the source in each view, relative to the flats, from the monitor."""
    found = []
    for entry in entries:
        views, flats = entry.frames(_PROJECTION), entry.frames(_FLAT)
        array = value_at(entry.group, "control/data")
        values = None if array is None else numbers_of(array, "number", "")
        if values is None or len(values) != len(entry.keys) or not len(flats) or values[flats].mean() <= 0:
            return None
        found.append(values[views] / values[flats].mean())
    return np.repeat(np.stack(found, axis=1), channels // len(entries), axis=1)
