"""Fingerprint of a scan: frames of two runs are the same when it is the same."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from hashlib import sha256
from typing import Any

import numpy as np

from phantomgen.runtime.versions import environment
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import Settings
from spectra.transmission import Transmission


def identity(scan: Scan, settings: Settings, transmission: Transmission, options: Mapping[str, str]) -> dict[str, str]:
    """Compute digests of everything that counts depend on, under names that a message may show.

    Objects, poses and energies are included beside the text of the scene, because meshes, voxel maps and tables have
    their own files.

    Parameters
    ----------
    scan, settings : what is simulated, how finely
    transmission : from path lengths to expected signals
    options : of the run, as they are

    Returns
    -------
    digests by name
    """
    versions = {name: version for name, version in environment().items() if name != "platform"}
    energies = (transmission.columns, transmission.weights, transmission.starts)
    return {
        "scene": digest(scan.text),
        "objects": digest(scan.scene.solids),
        "geometry": digest(scan.by_module.geometry.ray_frames()),
        "energies": digest(energies),
        "settings": digest(repr(settings)),
        "program or library version": digest(repr(sorted(versions.items()))),
        **options,
    }


def digest(value: Any) -> str:
    """Compute the SHA-256 of texts, numbers, arrays, and of tuples and dataclasses of these.

    Parameters
    ----------
    value : the value

    Returns
    -------
    hexadecimal digits
    """
    found = sha256()
    for part in _parts(value):
        found.update(part)
    return found.hexdigest()


def _parts(value: Any) -> list[bytes]:
    """Bytes that tell a value from all others."""
    if isinstance(value, np.ndarray):
        return [repr((value.dtype.str, value.shape)).encode(), np.ascontiguousarray(value).tobytes()]
    if is_dataclass(value):
        value = tuple(getattr(value, field.name) for field in fields(value))
    if isinstance(value, tuple | list):
        return [b"(", *(part for item in value for part in _parts(item)), b")"]
    return [repr(value).encode()]
