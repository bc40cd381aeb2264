"""Settings of all tests: hypothesis draws the same examples in every run, however slow the machine."""

import os
import subprocess
import sys
from contextlib import suppress

import pytest
from hypothesis import settings

os.environ.setdefault("TRITON_INTERPRET", "1")  # asked at import; 0 tests on a GPU, where there is one
with suppress(ImportError):  # before anything is rendered: its LLVM and that of Mesa load in this order only
    import triton  # noqa: F401

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")

PROBE = "import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Sphere()); p.screenshot()"


@pytest.fixture(scope="session")
def renders():
    """Skip where off-screen rendering ends the process, as it may without any OpenGL."""
    result = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=False)
    if result.returncode:
        pytest.skip(f"this machine cannot render: {(result.stderr.strip() or 'no message').splitlines()[-1]}")
