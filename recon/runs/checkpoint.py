"""Checkpoints: arrays and JSON in one file, which is written under another name and renamed when it is complete."""

import json
import os
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from phantomgen.geometry.curved_panel import flat_modules
from phantomgen.runtime.disk import one_sentence
from phantomgen.runtime.versions import environment
from recon.data.array_store import release
from recon.data.measurements import Measurements
from spectra.errors import DatasetError

_DIGEST = "sha256"  # key of that JSON: digest of the arrays and of the other keys
_HEADER = "content"  # key of the metadata of a safetensors file that holds the JSON


def write_checkpoint(path: Path, tensors: dict[str, Tensor], content: dict[str, Any]) -> None:
    """Write arrays and JSON as a safetensors file; `kill -9` leaves the old file or the new one.

    Parameters
    ----------
    path : the file
    tensors : arrays by name
    content : values that JSON can hold

    Raises
    ------
    StorageError
        When the disk is full or refuses.
    """
    from safetensors.torch import save  # noqa: PLC0415

    whole = {name: value.contiguous() for name, value in tensors.items()}
    header = json.dumps({_DIGEST: _digest(whole, content), **content})
    packed = save(whole, {_HEADER: header})
    write_whole(path, packed)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under another name, wait for the disk, and rename it.

    Parameters
    ----------
    path : the file
    data : its content

    Raises
    ------
    StorageError
        When the disk is full or refuses.
    """
    beside = path.with_name(path.name + ".new")
    with one_sentence(path):
        with beside.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, path)


def read_checkpoint(path: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read what `write_checkpoint` wrote.

    Parameters
    ----------
    path : the file

    Returns
    -------
    arrays by name, and the values of the JSON

    Raises
    ------
    DatasetError
        When the file is not such a file, or was damaged.
    """
    from safetensors import SafetensorError, safe_open  # noqa: PLC0415

    try:
        with safe_open(path, framework="pt") as file:
            content = json.loads((file.metadata() or {})[_HEADER])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a dict
        stated = content.pop(_DIGEST, None)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, AttributeError) as error:
        raise DatasetError(f"{path}: not a checkpoint written by recon ({error})") from error
    if stated != _digest(tensors, content):
        raise DatasetError(f"{path} is damaged, as it does not fit its digest: begin anew by --overwrite")
    return tensors, content


def _digest(tensors: dict[str, Tensor], content: dict[str, Any]) -> str:
    """SHA-256 of all that a checkpoint holds."""
    found = sha256(json.dumps(content, sort_keys=True).encode())
    for name in sorted(tensors):
        values = tensors[name].detach().cpu().contiguous()
        found.update(repr((name, str(values.dtype), tuple(values.shape))).encode())
        found.update(values.numpy().data if values.numel() else b"")
    return found.hexdigest()


def identity(measured: Measurements, options: dict[str, Any]) -> dict[str, str]:
    """Collect what must agree between two fits that give the same result.

    Parameters
    ----------
    measured : training views
    options : all else that results depend on, by name

    Returns
    -------
    texts, by the names that a message shows; that of ``dataset`` is a SHA-256 of all arrays
    """
    found = sha256()
    model = measured.transmission
    arrays = (
        measured.counts,
        measured.gains,
        measured.exposure,
        flat_modules(measured.geometry).ray_frames(),
        measured.profile,
    )
    for array in (*arrays, model.columns, model.weights, model.starts):
        values = np.ascontiguousarray(array if array is not None else [])
        found.update(repr((values.dtype.str, values.shape)).encode())
        found.update(values.data)
    release(measured.counts)
    versions = {name: version for name, version in environment().items() if name != "platform"}
    texts = {name: repr(value) for name, value in options.items()}
    return {"dataset": found.hexdigest(), "program or library version": json.dumps(versions, sort_keys=True), **texts}
