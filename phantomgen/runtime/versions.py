"""Versions of the program and of its libraries, for provenance."""

import platform
from importlib import metadata

PACKAGES = ("spectral-ct", "numpy", "scipy", "torch", "numba", "h5py", "xraylib", "spekpy")


def program_version() -> str:
    """Return the version of this distribution.

    Returns
    -------
    version; ``0`` in a source tree that is not installed
    """
    try:
        return metadata.version("spectral-ct")
    except metadata.PackageNotFoundError:
        return "0"


def environment() -> dict[str, str]:
    """Return the versions of Python, the platform and the libraries that results depend on.

    Returns
    -------
    versions by name
    """
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
