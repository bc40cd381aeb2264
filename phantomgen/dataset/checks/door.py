"""The only door to groups and arrays of an HDF5 file: what is opened here lies in that file, in the part that names it.

HDF5 can follow a link into another file, take the values of an array from any file of the computer, or put an array
together from several files. A dataset that came from elsewhere could so show what it does not hold. Soft links are
followed inside the same part of the root (``/entry``, ``/truth``).
"""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import product
from typing import Any

import h5py
import numpy as np

from spectra.errors import DatasetError, Error

_MOST_LINKS = 16  # soft links one after the other, as many as HDF5 follows
_HARD = 0  # H5L_TYPE_HARD of HDF5
DEEPEST = 32  # groups inside each other that are looked into
# What h5py raises on bytes that are not HDF5, and on sizes that no memory holds.
DAMAGE = (
    OSError,
    RuntimeError,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    MemoryError,
    OverflowError,
)


def array_at(parent: h5py.Group, name: str) -> h5py.Dataset:
    """Return an array that must exist.

    Parameters
    ----------
    parent : group
    name : path of the array

    Returns
    -------
    the array

    Raises
    ------
    DatasetError
        When it is missing, or its values are not in this file.
    """
    found = find_array(parent, name)
    if found is None:
        raise DatasetError(f"{parent.file.filename} lacks {full_name(parent, name)}")
    return found


def group_at(parent: h5py.Group, name: str) -> h5py.Group:
    """Return a group that must exist.

    Parameters
    ----------
    parent : group
    name : path of the group

    Returns
    -------
    the group

    Raises
    ------
    DatasetError
        When it is missing, or is not in this file.
    """
    found = find_group(parent, name)
    if found is None:
        raise DatasetError(f"{parent.file.filename} lacks {full_name(parent, name)}")
    return found


def find_array(parent: h5py.Group, name: str) -> h5py.Dataset | None:
    """Return an array, where there is one.

    Parameters
    ----------
    parent : group
    name : path of the array

    Returns
    -------
    the array; None where nothing, or something else, has this name

    Raises
    ------
    DatasetError
        When its values are not in this file.
    """
    found = _found(parent, name)
    if not isinstance(found, h5py.Dataset):
        return None
    with readable(parent, name):
        outside = _outside(found)
    if outside:
        raise DatasetError(f"{_place(parent, name)} {outside}: copy its values into the file")
    return found


def find_group(parent: h5py.Group, name: str) -> h5py.Group | None:
    """Return a group, where there is one.

    Parameters
    ----------
    parent : group
    name : path of the group

    Returns
    -------
    the group; None where nothing, or something else, has this name

    Raises
    ------
    DatasetError
        When it is not in this file.
    """
    found = _found(parent, name)
    return found if isinstance(found, h5py.Group) else None


def value_at(parent: h5py.Group, name: str) -> Any:
    """Read the whole value of an array that must exist.

    Parameters
    ----------
    parent : group
    name : path of the array

    Returns
    -------
    numbers or text, as an array or alone

    Raises
    ------
    DatasetError
        When it is missing, not in this file, or damaged.
    """
    array = array_at(parent, name)
    with readable(parent, name):
        check_stored(array)
        return decoded(array[()])


def names_in(group: h5py.Group) -> list[str]:
    """Return the names of all that lies in a group.

    Parameters
    ----------
    group : any group

    Returns
    -------
    names, in the order of the alphabet

    Raises
    ------
    DatasetError
        When the file is damaged.
    """
    with readable(group, "."):
        return sorted(map(str, group))


def decoded(value: Any) -> Any:
    """Convert text as h5py reads it to ``str``.

    Parameters
    ----------
    value : bytes, an array of them, or anything else

    Returns
    -------
    text, an array of texts, or the value as it is

    Raises
    ------
    ValueError
        When bytes are not UTF-8.
    """
    if isinstance(value, bytes):
        return value.decode()
    if isinstance(value, np.ndarray) and value.dtype.kind in "OS":
        texts = [text.decode() if isinstance(text, bytes) else text for text in value.ravel().tolist()]
        return np.array(texts, dtype=object).reshape(value.shape)
    return value


def frame_at(frames: h5py.Dataset, number: int) -> np.ndarray:
    """Read one frame of an array whose first axis counts frames.

    Parameters
    ----------
    frames : any array
    number : of the frame

    Returns
    -------
    the frame

    Raises
    ------
    DatasetError
        When a part of it is damaged, or is not where the file says; HDF5 would read zeros there.
    """
    with readable(frames.parent, f"{frames.name}[{number}]"):
        check_stored(frames)
        if frames.chunks is not None and frames.id.get_num_chunks():
            steps = zip(frames.shape[1:], frames.chunks[1:], strict=True)
            first = number - number % frames.chunks[0]
            for place in product(*(range(0, size, step) for size, step in steps)):
                frames.id.read_direct_chunk((first, *place))  # raises where there is none
        return frames[number]


def has(parent: h5py.Group, name: str) -> bool:
    """Return whether a group or an array exists.

    Parameters
    ----------
    parent : group
    name : its path

    Returns
    -------
    True where it does

    Raises
    ------
    DatasetError
        When it is not in this file.
    """
    return _found(parent, name) is not None


def outside_problems(group: h5py.Group, depth: int = 0) -> Iterator[str]:
    """Yield a sentence for each thing below a group that is not in its file, also where no reader goes.

    Parameters
    ----------
    group : where to begin
    depth : groups above it

    Yields
    ------
    sentences
    """
    for name in names_in(group):
        with readable(group, name):
            link = group.get(name, getlink=True)
            item = group[name] if isinstance(link, h5py.HardLink) else None
            outside = _outside(item) if isinstance(item, h5py.Dataset) else ""
        if isinstance(link, h5py.ExternalLink):
            yield f"{_place(group, name)} is a link into another file, {link.filename}: copy what it links to"
        if isinstance(item, h5py.Dataset) and outside and not shows_own(item):
            yield f"{_place(group, name)} {outside}: copy its values into the file"
        if isinstance(item, h5py.Group) and depth < DEEPEST:
            yield from outside_problems(item, depth + 1)


def shows_own(array: h5py.Dataset) -> bool:
    """Return whether an array of an NXtomo entry shows arrays of the same file.

    Parameters
    ----------
    array : any array

    Returns
    -------
    True for a virtual dataset of ``/nxtomo_<channel>`` with sources in this file only
    """
    with readable(array.parent, str(array.name)):
        return (
            str(array.name).startswith("/nxtomo_")
            and array.is_virtual
            and all(source.file_name == "." for source in array.virtual_sources())
        )


def check_stored(array: h5py.Dataset) -> None:
    """Refuse an array in one piece whose values are not all in the file: HDF5 would read zeros, or ask for any memory.

    Parameters
    ----------
    array : any array

    Raises
    ------
    ValueError
        When fewer bytes are stored than its shape takes.
    """
    size = int(np.prod(array.shape or (), dtype=object)) * array.dtype.itemsize
    if array.shape is not None and array.chunks is None and array.id.get_storage_size() < size:
        raise ValueError("stored bytes are fewer than its shape takes")


@contextmanager
def readable(parent: Any, name: str) -> Iterator[None]:
    """Convert what HDF5 raises on damaged bytes to one sentence; a context manager.

    Parameters
    ----------
    parent, name : group and path of what is read, for the message

    Yields
    ------
    nothing

    Raises
    ------
    DatasetError
        When it cannot be read.
    """
    try:
        yield
    except Error:
        raise
    except DAMAGE:
        raise DatasetError(f"{_place(parent, name)} cannot be read: the file is damaged") from None


def full_name(parent: h5py.Group, name: str) -> str:
    """Return a path from the root.

    Parameters
    ----------
    parent, name : a group, and a path from there

    Returns
    -------
    the path
    """
    return name if name.startswith("/") else f"{str(parent.name).rstrip('/')}/{name}".removesuffix("/.")


def _found(parent: h5py.Group, name: str) -> Any:
    """Find the item at a path, or None; each link on the way is looked at before it is followed."""
    path = full_name(parent, name)
    parts, top = [part for part in path.split("/") if part], ""
    node: Any = parent.file
    if (found := _along_hard_links(node, parts)) is not None:
        return found
    done: list[str] = []
    followed = 0
    while parts:
        part = parts.pop(0)
        if not isinstance(node, h5py.Group):
            return None
        with readable(parent, name):
            link = node.get(part, getlink=True)
        if link is None:
            return None
        if isinstance(link, h5py.ExternalLink):
            raise DatasetError(
                f"{_place(parent, name)} is a link into another file, {link.filename}: copy what it links to"
            )
        if isinstance(link, h5py.SoftLink):
            followed += 1
            target = [p for p in link.path.split("/") if p]
            target = target if link.path.startswith("/") else [*done, *target]
            if followed > _MOST_LINKS:
                raise DatasetError(f"{_place(parent, name)} is a link that leads back to itself")
            if done and target[:1] != [top]:
                raise DatasetError(
                    f"{_place(parent, name)} is a link to {link.path}, out of /{top}: copy what it links to"
                )
            parts, node, done = [*target, *parts], parent.file, []
            continue
        with readable(parent, name):
            node = node[part]
        done.append(part)
        top = done[0]
    return node


def is_hard_link(group: h5py.Group, path: str) -> bool:
    """Tell whether a path ends at an item of this file itself, which HDF5 says faster than h5py.

    Parameters
    ----------
    group : where the path begins
    path : the path, whose links but for the last are followed

    Returns
    -------
    False for soft and external links

    Raises
    ------
    KeyError
        When nothing is there.
    """
    return group.id.links.get_info(path.encode("utf-8", "surrogateescape")).type == _HARD


def _along_hard_links(file: h5py.File, parts: list[str]) -> Any:
    """Find the item at a path whose links are all hard, as most are; None where one is not, or nothing is there."""
    path = ""
    try:
        for part in parts:
            path += f"/{part}"
            if not is_hard_link(file, path):
                return None
        return file[path] if path else None
    except DAMAGE:
        return None


def _outside(array: h5py.Dataset) -> str:
    """How the values of an array come from elsewhere; empty where they do not."""
    if array.external:
        return f"has its values in other files, such as {array.external[0][0]}"
    if array.is_virtual:
        return "is put together from other arrays (a virtual dataset)"
    return ""


def _place(parent: h5py.Group, name: str) -> str:
    """File and path, for messages."""
    return f"{parent.file.filename}: {full_name(parent, name)}"
