"""Digests of a dataset: what it holds is what was written, or one sentence says which part is not.

HDF5 checks nothing by itself. A flipped bit in the index of an array makes some of its chunks vanish, which then read
as zeros; one in a spectrum or in a pixel size is a value like any other. So every chunk carries a checksum
(Fletcher-32) and every part of the file, such as ``/entry/spectra``, a digest: SHA-256 of names, types, attributes,
links, the values of all arrays that are not cut into chunks, and the list of the chunks of the others.
"""

import json
from collections.abc import Iterator
from hashlib import sha256
from math import ceil, prod
from typing import Any

import h5py
import numpy as np

from phantomgen.dataset.checks.door import (
    DAMAGE,
    DEEPEST,
    check_stored,
    find_group,
    is_hard_link,
    names_in,
    readable,
    shows_own,
)
from phantomgen.dataset.checks.fletcher import fletcher32
from spectra.errors import DatasetError

DIGESTS = "digests"  # attribute of the root, of /entry, of /truth and of each /nxtomo_<channel>
_OWN = "."  # key of the attributes of the group itself


def seal(file: h5py.File) -> None:
    """Write the digests of all parts of a file as it is now.

    Parameters
    ----------
    file : open dataset, which may be written
    """
    file.flush()  # chunks get their sizes when they leave the memory
    for group in (file, *_tops(file)):
        group.attrs[DIGESTS] = json.dumps(_digests(group), indent=1)


def check_seal(file: h5py.File, top: str = "entry") -> None:
    """Refuse a file that is not as it was written.

    Parameters
    ----------
    file : open dataset
    top : part of the root that is checked: ``entry`` or ``truth``

    Raises
    ------
    DatasetError
        When a part differs from its digest, or is missing.
    """
    for problem in seal_problems(file, (top,)):
        raise DatasetError(problem)


def seal_problems(file: h5py.File, tops: tuple[str, ...] | None = None) -> Iterator[str]:
    """Yield a sentence for each part of a file that is not as it was written; none for files without digests.

    Parameters
    ----------
    file : open dataset
    tops : parts of the root that are checked beside the attributes of the root; all, and what nobody knows, where None

    Yields
    ------
    sentences
    """
    if not _is_sealed(file):
        return
    yield from _differences(file, whole=True)
    known = {str(group.name).strip("/"): group for group in _tops(file)}
    for name in sorted(known.keys() if tops is None else known.keys() & set(tops)):
        yield from _differences(known[name], whole=tops is None)
    if tops is None:
        for name in sorted(set(names_in(file)) - known.keys()):
            yield f"{file.filename}: /{name} was not there when the file was written"


def chunk_problems(file: h5py.File) -> Iterator[str]:
    """Yield a sentence for each array with a chunk that cannot be found or does not fit its checksum.

    The list of chunks and the way by which HDF5 finds one of them are different parts of a file.

    Parameters
    ----------
    file : open dataset

    Yields
    ------
    sentences
    """
    for array in _own_arrays(file, 0):
        try:
            for place, size, _ in _chunks(array):
                data = array.id.read_direct_chunk(place)[1]
                if len(data) != size or (array.fletcher32 and fletcher32(data[:-4]) != data[-4:]):
                    raise ValueError("checksum")
                if not array.fletcher32:
                    _ = array[tuple(slice(a, a + b) for a, b in zip(place, array.chunks or (), strict=True))]
        except DAMAGE:
            yield f"{file.filename}: a part of {array.name} is damaged"


def _own_arrays(group: h5py.Group, depth: int) -> Iterator[h5py.Dataset]:
    """Arrays in chunks, soft links left out."""
    for name in names_in(group):
        with readable(group, name):
            item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
        if isinstance(item, h5py.Group) and depth < DEEPEST:
            yield from _own_arrays(item, depth + 1)
        elif isinstance(item, h5py.Dataset) and item.chunks is not None:
            yield item


def missing_chunks(array: h5py.Dataset) -> int:
    """Count chunks of an array that are not in the file, and read as zeros.

    Parameters
    ----------
    array : any array

    Returns
    -------
    number of missing chunks; 0 for an array that is not cut into chunks
    """
    if array.chunks is None or array.shape is None:
        return 0
    expected = prod(ceil(size / chunk) for size, chunk in zip(array.shape, array.chunks, strict=True))
    with readable(array.parent, str(array.name)):
        return expected - len({chunk[0] for chunk in _chunks(array)})


def _is_sealed(file: h5py.File) -> bool:
    """Whether a file has digests; one of them is enough, as another may be damaged."""
    with readable(file, "/"):
        return any(DIGESTS in group.attrs for group in (file, *_tops(file)))


def _tops(file: h5py.File) -> Iterator[h5py.Group]:
    """Groups in the root that the program writes."""
    for name in names_in(file):
        group = find_group(file, name) if name in {"entry", "truth"} or name.startswith("nxtomo_") else None
        if group is not None:
            yield group


def _differences(group: h5py.Group, whole: bool) -> Iterator[str]:
    """Parts of a group that differ from their digests; parts that were added count where `whole`."""
    where, edited = f"{group.file.filename}: {group.name}", "if you changed it, `phantomgen validate --seal` accepts it"
    try:
        stated = json.loads(str(group.attrs[DIGESTS]))
        found = _digests(group)
    except (*DAMAGE, RecursionError):
        yield f"{where} has no digests that can be read: the file is damaged"
        return
    for name in sorted(stated.keys() | found.keys()):
        place = "has attributes that" if name == _OWN else f"has a part {name} that"
        if name not in stated:
            if whole:
                yield f"{where} {place} was not there when the file was written; {edited}"
        elif name not in found:
            yield f"{where} lacks {name}, which was there when the file was written; {edited}"
        elif found[name] != stated[name]:
            yield f"{where} {place} is damaged, or not as it was written; {edited}"


def _digests(group: h5py.Group) -> dict[str, str]:
    """Digests of the attributes of a group, and of each thing in it; of the root, attributes only."""
    own = sha256()
    _add_attributes(own, group)
    found = {_OWN: own.hexdigest()}
    if isinstance(group, h5py.File):
        return found
    for name in sorted(map(str, group)):
        digest = sha256()
        try:
            _add(digest, group, name, 0)
            found[name] = digest.hexdigest()
        except DAMAGE:
            found[name] = "cannot be read"
    return found


def _add(digest: Any, group: h5py.Group, name: str, depth: int) -> None:
    """Add one thing of a group to a digest."""
    if is_hard_link(group, name):
        _add_text(digest, name, h5py.HardLink.__name__)
    else:
        link = group.get(name, getlink=True)
        _add_text(digest, name, type(link).__name__)
        if isinstance(link, h5py.SoftLink | h5py.ExternalLink):
            _add_text(digest, link.path, getattr(link, "filename", ""))
            return
    item = group[name]
    _add_attributes(digest, item)
    if isinstance(item, h5py.Group):
        if depth > DEEPEST:
            raise ValueError("groups lie too deep in each other")
        for below in sorted(map(str, item)):
            _add(digest, item, below, depth + 1)
        _add_text(digest, "end of group")
    elif isinstance(item, h5py.Dataset):
        _add_array(digest, item)
    else:
        _add_text(digest, repr(type(item)))


def _add_array(digest: Any, array: h5py.Dataset) -> None:
    """Add type and shape of an array, and either its values or the list of its chunks."""
    _add_text(digest, str(array.dtype), repr(array.shape), repr(array.chunks), repr(array.external))
    if array.is_virtual:
        if not shows_own(array):
            raise ValueError("the door refuses these values")
        for source in array.virtual_sources():
            spaces = [(space.shape, space.get_select_bounds()) for space in (source.vspace, source.src_space)]
            _add_text(digest, source.file_name, source.dset_name, repr(spaces))
    elif array.chunks is None:
        check_stored(array)
        _add_value(digest, array[()])
    else:
        plan = array.id.get_create_plist()
        _add_text(digest, repr([plan.get_filter(i) for i in range(plan.get_nfilters())]))
        _add_value(digest, array.fillvalue)
        _add_text(digest, repr(sorted(_chunks(array))))


def _add_attributes(digest: Any, item: Any) -> None:
    """Add the attributes of a group or an array."""
    for name in sorted(item.attrs):
        if name != DIGESTS:
            _add_text(digest, name)
            _add_value(digest, item.attrs[name])


def _add_value(digest: Any, value: Any) -> None:
    """Add numbers or texts, with their type and shape."""
    if isinstance(value, h5py.Empty):
        _add_text(digest, "empty", str(value.dtype))
        return
    array = np.asarray(value)
    if array.dtype.kind in "OUS":
        texts = [text.decode() if isinstance(text, bytes) else str(text) for text in array.ravel().tolist()]
        _add_text(digest, "text", repr(array.shape), *texts)
        return
    _add_text(digest, array.dtype.str, repr(array.shape))
    digest.update(np.ascontiguousarray(array).tobytes())


def _add_text(digest: Any, *texts: str) -> None:
    """Add texts, each with its length."""
    for text in texts:
        data = text.encode(errors="surrogateescape")
        digest.update(len(data).to_bytes(8, "little") + data)


def _chunks(array: h5py.Dataset) -> list[tuple[tuple[int, ...], int, int]]:
    """Place, number of bytes, and filters left out of each chunk."""
    found: list[Any] = []
    if hasattr(array.id, "chunk_iter"):
        array.id.chunk_iter(found.append)
    else:  # HDF5 before 1.12.3
        found = [array.id.get_chunk_info(i) for i in range(array.id.get_num_chunks())]
    return [(tuple(map(int, chunk.chunk_offset)), int(chunk.size), int(chunk.filter_mask)) for chunk in found]
