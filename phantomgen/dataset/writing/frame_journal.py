"""Finished frames of a scan, in a file that survives `kill -9` at any moment.

Frames are appended one by one, packed as the dataset will hold them, each behind a line of JSON and a checksum; what is
torn at the end is found by its checksum and computed again. An HDF5 file would not do: it keeps the index of its chunks
in memory, and of 59 writers that were killed while they wrote and flushed frame after frame, one left an array that
could not be read. The dataset is put together from the journal at the end, by the same calls whether the run was
interrupted or not, so that it is the same file.
"""

import json
import os
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, BinaryIO

from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.output_lock import acquire, refuse_locked
from phantomgen.runtime.outputs import refuse_interrupted
from spectra.errors import Error, InputError, StorageError

SUFFIX = ".frames"
Packed = list[list[bytes]]
Frame = dict[str, Packed]
_CHECK = 4  # bytes of a checksum
# Most bytes of a line that begins a frame; a longer one is damaged.
_LONGEST_HEAD = 1 << 20


def journal_path(out: Path) -> Path:
    """Return the name of the journal of a dataset.

    Parameters
    ----------
    out : final name of the dataset

    Returns
    -------
    name of the journal
    """
    return out.with_name(out.name + SUFFIX)


def check_journal(out: Path, resume: bool, overwrite: bool) -> None:
    """Refuse to begin where an interrupted run left its frames, unless given an option for them.

    Parameters
    ----------
    out : final name of the dataset
    resume : go on with these frames
    overwrite : remove them

    Raises
    ------
    InputError
        When frames exist and neither option is given, or another process writes them.
    """
    path = journal_path(out)
    refuse_locked(path)
    if path.exists():
        refuse_interrupted(path, resume, overwrite)


class FrameJournal:
    """The journal of one dataset; use it in a ``with`` statement.

    It is removed when all went well, and after errors that would come again. It is kept, to be resumed, after an
    interruption, a full disk, or a fault of the program.

    Parameters
    ----------
    out : final name of the dataset
    identity : what must be the same for frames to be the same; shown by its names when it is not
    resume : go on with the frames that are there, if any
    overwrite : begin anew where frames are there, or with `resume` where they are those of another scan
    """

    def __init__(self, out: Path, identity: Mapping[str, str], resume: bool = False, overwrite: bool = False) -> None:
        self.path = journal_path(out)
        self.identity = dict(identity)
        self.resume, self.overwrite = resume, overwrite
        self.finished: dict[str, int] = {}
        check_journal(out, resume, overwrite)

    def __enter__(self) -> "FrameJournal":
        with one_sentence(self.path):
            self._owner = acquire(self.path)
        try:
            return self._entered()
        except BaseException:
            self._owner.unlink(missing_ok=True)
            raise

    def _entered(self) -> "FrameJournal":
        """Open the file."""
        with one_sentence(self.path):
            self._file = open(os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666), "r+b", buffering=0)  # noqa: SIM115
        try:
            self._lock()
            end = self._read_finished() if self.resume else 0
            with one_sentence(self.path):
                self._file.truncate(end)
                self._file.seek(end)
            if not end:
                self._write({"identity": self.identity})
        except BaseException:
            empty = not self.size
            self._file.close()
            if empty:
                self.path.unlink(missing_ok=True)
            raise
        return self

    def __exit__(self, kind: type | None, *exception: object) -> None:
        unusable = kind is not None and issubclass(kind, Error) and not issubclass(kind, StorageError)
        self._file.close()
        self._owner.unlink(missing_ok=True)
        if kind is None or unusable or not self.finished:
            self.path.unlink(missing_ok=True)
        elif issubclass(kind, KeyboardInterrupt):
            kept = " and ".join(f"{count} {name}" for name, count in self.finished.items())
            raise kind(f"{kept} are kept in {self.path}: go on by --resume")

    @property
    def size(self) -> int:
        """Size of the file [byte]."""
        return os.fstat(self._file.fileno()).st_size

    def done(self, kind: str) -> int:
        """Return the number of finished frames of a kind; they are finished in order.

        Parameters
        ----------
        kind : kind of frame

        Returns
        -------
        number of frames
        """
        return self.finished.get(kind, 0)

    def append(self, kind: str, number: int, frame: Frame, needed: float | None = None) -> None:
        """Append a finished frame.

        Parameters
        ----------
        kind, number : which one
        frame : packed images of all channels, by the name of their array
        needed : room that this and all later frames take [byte], to be said when the disk is full
        """
        sizes = {name: [[len(chunk) for chunk in image] for image in images] for name, images in frame.items()}
        chunks = [chunk for images in frame.values() for image in images for chunk in image]
        self._write({"kind": kind, "frame": number, "sizes": sizes}, chunks, needed)
        self.finished[kind] = number + 1

    def frames(self) -> Iterator[tuple[str, int, Frame]]:
        """Yield all frames in the order in which they were appended.

        Yields
        ------
        kind, number and frame
        """
        with self.path.open("rb") as reader:
            for head, body in _records(reader):
                if "kind" in head:
                    yield head["kind"], head["frame"], _unpacked(head["sizes"], body)

    def _write(self, head: dict[str, Any], chunks: list[bytes] | None = None, needed: float | None = None) -> None:
        """Append one record: a line of JSON, the checksum of it and of what follows, chunks."""
        line, body = json.dumps(head).encode() + b"\n", b"".join(chunks or ())
        data = memoryview(line + _checksum(line, body) + body)
        end = self.size
        try:
            with one_sentence(self.path, needed):
                while data:
                    data = data[self._file.write(data) :]
        except StorageError:
            with suppress(OSError):
                self._file.truncate(end)
            raise

    def _read_finished(self) -> int:
        """Count frames that are whole; return where the last one ends.

        Raises
        ------
        InputError
            When they are those of another scan.
        """
        end = 0
        with self.path.open("rb") as reader:
            for head, _ in _records(reader):
                if end == 0 and not self._is_mine(head.get("identity", {})):
                    return 0
                if "kind" in head:
                    if head["frame"] != self.done(head["kind"]):
                        break
                    self.finished[head["kind"]] = head["frame"] + 1
                end = reader.tell()
        return end

    def _is_mine(self, identity: dict[str, str]) -> bool:
        """Return whether frames with this identity are those of this scan."""
        names = {*identity, *self.identity}
        other = sorted(name for name in names if identity.get(name) != self.identity.get(name))
        if other and not self.overwrite:
            raise InputError(
                f"{self.path} cannot be resumed, as it was begun with another {' and '.join(other)}: "
                "ask for the same, or begin anew by --overwrite"
            )
        return not other

    def _lock(self) -> None:
        """Refuse a journal that another process writes; the lock ends with that process, however it ends."""
        with suppress(ImportError):  # Windows has no such locks
            import fcntl  # noqa: PLC0415

            try:
                fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(f"{self.path} is being written by another process") from None
            except OSError:
                return  # file systems without locks


def _records(reader: BinaryIO) -> Iterator[tuple[dict[str, Any], bytes]]:
    """Whole records, up to the first that is torn."""
    while line := reader.readline(_LONGEST_HEAD):
        try:
            head = json.loads(line)
            length = sum(size for images in head.get("sizes", {}).values() for image in images for size in image)
        except (ValueError, AttributeError, TypeError):
            return
        check, body = reader.read(_CHECK), reader.read(length)
        if len(body) != length or check != _checksum(line, body):
            return
        yield head, body


def _checksum(line: bytes, body: bytes) -> bytes:
    """CRC-32 of a record."""
    return zlib.crc32(body, zlib.crc32(line)).to_bytes(_CHECK, "little")


def _unpacked(sizes: dict[str, list[list[int]]], body: bytes) -> Frame:
    """Chunks of a record in their places."""
    frame: Frame = {}
    first = 0
    for name, images in sizes.items():
        frame[name] = []
        for image in images:
            ends = [first + sum(image[: i + 1]) for i in range(len(image))]
            frame[name].append([body[end - size : end] for end, size in zip(ends, image, strict=True)])
            first += sum(image)
    return frame
