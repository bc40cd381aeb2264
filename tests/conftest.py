"""Settings of all tests: types and axes of all calls are checked, hypothesis repeats its examples in every run."""

import os
import subprocess
import sys
from contextlib import suppress

import pytest
from hypothesis import settings
from jaxtyping import config
from support.checked_types import check_types

# Processes of pytest-xdist share the processors: pools of threads that wait for each other make all of them slower.
if (workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))) > 1:
    os.environ.setdefault("OMP_NUM_THREADS", str(max((os.cpu_count() or 1) // workers, 1)))

os.environ.setdefault("TRITON_INTERPRET", "1")  # asked at import; 0 tests on a GPU, where there is one
with suppress(ImportError):  # before anything is rendered: its LLVM and that of Mesa load in this order only
    import triton  # noqa: F401

check_types(os.environ.get("CHECKED_TYPES", "spectra phantomgen recon").split())  # before any of these is imported

settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.fixture(autouse=True)
def checked_types(request):
    """Let arguments of wrong types through to a function's own checks, in tests that are marked `wrong_types`."""
    before = config.jaxtyping_disable  # JAXTYPING_DISABLE=1 turns all checks off
    config.update("jaxtyping_disable", before or request.node.get_closest_marker("wrong_types") is not None)
    yield
    config.update("jaxtyping_disable", before)


PROBE = "import pyvista; p = pyvista.Plotter(off_screen=True); p.add_mesh(pyvista.Sphere()); p.screenshot()"


@pytest.fixture(scope="session")
def renders():
    """Skip where off-screen rendering ends the process, as it may without any OpenGL."""
    result = subprocess.run([sys.executable, "-c", PROBE], capture_output=True, text=True, check=False)
    if result.returncode:
        pytest.skip(f"this machine cannot render: {(result.stderr.strip() or 'no message').splitlines()[-1]}")
