"""Which program, and which of its libraries, made a file."""

import platform
from importlib import metadata

PACKAGES = ("spectral-ct", "numpy", "scipy", "torch", "numba", "h5py", "xraylib", "spekpy")


def program_version() -> str:
    """Version of this distribution; ``0`` in a source tree that is not installed."""
    try:
        return metadata.version("spectral-ct")
    except metadata.PackageNotFoundError:
        return "0"


def environment() -> dict[str, str]:
    """Versions of Python, the platform and the libraries that numbers depend on."""
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    for package in PACKAGES:
        try:
            versions[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            continue
    return versions
