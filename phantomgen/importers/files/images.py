"""Images in TIFF files and raw files, read one by one; what a header says is checked against the size of its file."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from jaxtyping import Shaped

from spectra.errors import InputError

# No compression of numbers makes them smaller than this (deflate: 1032).
_MOST_COMPRESSED = 1100
_SUFFIXES = (".tif", ".tiff")
Image = Shaped[np.ndarray, "row column"]


@dataclass(frozen=True)
class Stack:
    """Images of the same shape.

    Parameters
    ----------
    shape : rows and columns
    images : functions that read one each
    """

    shape: tuple[int, int]
    images: tuple[Callable[[], Image], ...]

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, number: int) -> Image:
        return self.images[number]()

    def all(self) -> Shaped[np.ndarray, "frame row column"]:
        """Read all images.

        Returns
        -------
        the images
        """
        return np.stack([read() for read in self.images])


def tiff_stack(paths: Sequence[Path], shape: tuple[int, int] | None = None) -> Stack:
    """Describe the images of TIFF files, which may hold several each.

    Parameters
    ----------
    paths : files in the order of the images
    shape : rows and columns that they must have; those of the first where left out

    Returns
    -------
    the images, which are read when they are asked for

    Raises
    ------
    InputError
        When a file is missing, no TIFF, cut off, or holds images of another shape.
    """
    images: list[Callable[[], Image]] = []
    like = "" if shape is not None or not paths else f" like {paths[0].name}"
    for path in paths:
        pages, found = _pages(path)
        shape = shape or found
        if found != shape:
            raise InputError(f"{path} has {_size(found)} pixels, expected {_size(shape)}{like}")
        images += [partial(_read, path, page, shape) for page in ([None] if pages is None else range(pages))]
    if shape is None:
        raise InputError("there are no images")
    return Stack(shape, tuple(images))


def tiffs_like(settings: Path, pattern: str) -> list[Path]:
    """Return the TIFF files of a pattern in the order of their names.

    Parameters
    ----------
    settings : file that names the pattern, which starts in its folder
    pattern : such as ``low/view_*.tif``

    Returns
    -------
    the files, at least one

    Raises
    ------
    InputError
        When there are none.
    """
    try:
        found = sorted(path for path in settings.parent.glob(pattern) if path.suffix.lower() in _SUFFIXES)
    except (ValueError, NotImplementedError):
        raise InputError(f"{settings}: {pattern!r} is no pattern of files in the folder") from None
    if not found:
        raise InputError(f"{settings}: there is no TIFF file {pattern}")
    return found


def numbered_tiffs(folder: Path, name: str) -> list[Path]:
    """Return TIFF files whose name is a text and a number, in the order of the numbers.

    Parameters
    ----------
    folder : that holds them
    name : text before the number

    Returns
    -------
    the files; an empty list where there are none

    Raises
    ------
    InputError
        When a number between the first and the last is missing.
    """
    found = {}
    for path in folder.iterdir() if folder.is_dir() else ():
        number = path.stem[len(name) :]
        if path.stem.startswith(name) and number.isdigit() and path.suffix.lower() in _SUFFIXES:
            found[int(number)] = path
    missing = sorted(set(range(min(found, default=0), max(found, default=0))) - set(found))
    if missing:
        raise InputError(f"{folder}: of the images {name}*, number {missing[0]} is missing")
    return [found[number] for number in sorted(found)]


def raw_stack(path: Path, views: int, shape: tuple[int, int], dtype: str = "<u2") -> Stack:
    """Describe the images of a file without header.

    Parameters
    ----------
    path : the file
    views : number of images
    shape : rows and columns
    dtype : of the pixels

    Returns
    -------
    the images, which are read when they are asked for

    Raises
    ------
    InputError
        When the file has another size.
    """
    expected = views * shape[0] * shape[1] * np.dtype(dtype).itemsize
    if not path.is_file() or path.stat().st_size != expected:
        size = f"has {path.stat().st_size} bytes" if path.is_file() else "is no file"
        raise InputError(f"{path} {size}, but {views} images of {_size(shape)} pixels of {dtype} take {expected}")

    def read(number: int) -> Image:
        count = shape[0] * shape[1]
        return np.fromfile(path, dtype, count, offset=number * count * np.dtype(dtype).itemsize).reshape(shape)

    return Stack(shape, tuple(partial(read, number) for number in range(views)))


def _pages(path: Path) -> tuple[int | None, tuple[int, int]]:
    """Number of images of a stack, None for a single one, and their shape, if the file can hold it."""
    with _opened(path) as file:
        series = file.series[0] if file.series else None
        shape = [] if series is None else [int(n) for n in series.shape]
        if series is None or len(shape) not in (2, 3) or series.dtype is None or series.dtype.kind not in "uif":
            kind = "nothing" if series is None else f"{series.dtype} of shape {tuple(shape)}"
            raise InputError(f"{path} holds {kind}, expected grey values (row, column) or a stack of them")
        need, size = int(np.prod(shape, dtype=np.int64)) * series.dtype.itemsize, path.stat().st_size
        compressed = int(file.pages[0].compression) != 1  # type: ignore[union-attr]
        if need > size * (_MOST_COMPRESSED if compressed else 1):
            raise InputError(
                f"{path} is cut off: it declares {_size(shape)} pixels, {need} bytes, and has {size} bytes"
            )
        return (None if len(shape) == 2 else shape[0]), (shape[-2], shape[-1])


def _read(path: Path, page: int | None, shape: tuple[int, int]) -> Image:
    """One image of a file; None for the only one."""
    if page is None:
        with _opened(path) as file:
            image = file.series[0].asarray()
    else:
        with _sentence(path):
            state = path.stat()
            image = _kept_open(path, state.st_mtime_ns, state.st_size).tiff.series[0].asarray(key=page)
    image = np.asarray(image)
    if image.shape != shape:
        raise InputError(f"{path} has {_size(image.shape)} pixels, expected {_size(shape)}")
    return image


class _KeptOpen:
    """An open TIFF file of many images, closed when it is forgotten."""

    def __init__(self, path: Path) -> None:
        self.tiff = tifffile.TiffFile(path)

    def __del__(self) -> None:
        if hasattr(self, "tiff"):
            self.tiff.close()


@lru_cache(maxsize=8)
def _kept_open(path: Path, *state: int) -> _KeptOpen:
    """Open a file once, as the directory of a file of thousands of images takes long to read."""
    del state  # a file that was changed is another one
    return _KeptOpen(path)


@contextmanager
def _opened(path: Path) -> Iterator[tifffile.TiffFile]:
    """Open a TIFF file."""
    with _sentence(path), tifffile.TiffFile(path) as file:
        yield file


@contextmanager
def _sentence(path: Path) -> Iterator[None]:
    """Turn whatever tifffile makes of a damaged file to a sentence."""
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    try:
        yield
    except InputError:
        raise
    except Exception:
        raise InputError(f"{path} cannot be read: it is no TIFF file, damaged or cut off") from None


def _size(shape: Any) -> str:
    return " x ".join(str(n) for n in shape)
