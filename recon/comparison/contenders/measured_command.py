"""A command as a process below this one, with its time and memory; run as a program of its own.

On Linux the largest memory of a process includes that of its parent at the moment of its start. This program is small,
so that what it measures is the command's. It imports the standard library only.
"""

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any


def measured(words: list[str]) -> dict[str, Any]:
    """Run a command to its end.

    Parameters
    ----------
    words : program and arguments

    Returns
    -------
    ``status``, ``seconds`` of wall time, ``processor`` time [s] and largest ``memory`` [MiB] of one of its processes;
    the last two None where the system does not tell; or ``error`` where it cannot be run
    """
    began = time.perf_counter()
    try:
        status = subprocess.run(words, stdin=subprocess.DEVNULL, check=False).returncode
    except OSError as error:
        return {"error": f"the command cannot be run: {error.strerror}: {words[0]}"}
    found = {"status": status, "seconds": time.perf_counter() - began, "processor": None, "memory": None}
    try:
        import resource  # noqa: PLC0415 - not on Windows
    except ImportError:
        return found
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return found | {"processor": used.ru_utime + used.ru_stime, "memory": used.ru_maxrss / unit}


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(measured(sys.argv[2:])), encoding="utf-8")
