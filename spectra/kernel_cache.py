"""Where compiled kernels are kept when neither the packages nor the home of the user can be written.

numba keeps them beside the code or below the user's home, and refuses to import a kernel where it can do neither, as in
containers and on clusters. Importing a package ``ops`` then names a temporary folder of the user's own in
``NUMBA_CACHE_DIR``, so that processes that are started from here share it. What lies in such a folder is run as code:
it must belong to this user alone.
"""

import atexit
import os
import shutil
import stat
import sys
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path

from spectra.errors import MachineWarning, StorageError

VARIABLE = "NUMBA_CACHE_DIR"
_NAME = "spectral-ct-kernels-"


def ensure_kernel_cache(operators: Path) -> None:
    """Name a temporary folder for compiled kernels, with a warning, where numba finds no other that it can write.

    Parameters
    ----------
    operators : folder ``ops`` of a package, which holds a folder per operator

    Raises
    ------
    StorageError
        When no temporary folder can be written either.
    """
    chosen, home = os.environ.get(VARIABLE, ""), _home_cache()
    if (chosen and _can_write(Path(chosen))) or _beside_code(operators) or (home.is_absolute() and _can_write(home)):
        return
    what = f"{VARIABLE}={chosen}, " if chosen else ""
    try:
        folder = temporary_folder()
    except OSError:
        raise StorageError(
            f"no folder for compiled kernels can be written, neither {what}{operators}, {home} nor a temporary one: "
            f"set {VARIABLE} to one that can"
        ) from None
    warnings.warn(
        f"compiled kernels are kept in {folder}, as {what}{operators} and {home} cannot be written: "
        f"set {VARIABLE} to a folder that can, and that lasts",
        MachineWarning,
        stacklevel=2,
    )
    os.environ[VARIABLE] = str(folder)
    settings = getattr(sys.modules.get("numba"), "config", None)
    if settings is not None:  # numba has read the environment already
        settings.CACHE_DIR = str(folder)


def temporary_folder() -> Path:
    """Return a temporary folder that belongs to this user alone.

    Returns
    -------
    the same folder in every run; where another user owns that name, a folder for this run only
    """
    folder = Path(tempfile.gettempdir(), f"{_NAME}{os.getuid() if hasattr(os, 'getuid') else 'user'}")
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    if _is_own(folder) and _can_write(folder):
        return folder
    private, maker = Path(tempfile.mkdtemp(prefix=_NAME)), os.getpid()
    atexit.register(lambda: shutil.rmtree(private, ignore_errors=True) if os.getpid() == maker else None)
    return private


def _is_own(folder: Path) -> bool:
    """Return whether only this user can have written into the folder; a symbolic link is refused."""
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    return not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o077)


def _home_cache() -> Path:
    """Return the folder below the user's home where numba stores kernels; a relative path where the home is unknown."""
    home = Path(os.path.expanduser("~"))  # as numba does; pathlib raises without a home
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local", "numba", "Cache")
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "numba"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache", "numba")


def _beside_code(operators: Path) -> bool:
    """Return whether all kernels of a package can be stored beside its code."""
    inside = (folder for folder in operators.iterdir() if folder.is_dir() and folder.name != "__pycache__")
    return all(_can_write(folder / "__pycache__") for folder in (operators.parent, operators, *inside))


def _can_write(folder: Path) -> bool:
    """Return whether a file can be written in the folder, which is created if necessary, as numba does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError:
        return False
    return True
