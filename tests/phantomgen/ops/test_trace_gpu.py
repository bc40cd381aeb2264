"""Path lengths in Triton, which runs in its interpreter or, with TRITON_INTERPRET=0, on a GPU."""

import os
import subprocess
import sys

import numpy as np
import pytest
import torch

from phantomgen.ops.trace.reference import trace_one
from phantomgen.shapes import Box, Cone, Cylinder, Ellipsoid, Shape, Sphere, Torus, Union, solids_of
from spectra.errors import InputError

DEVICE = "cuda" if os.environ["TRITON_INTERPRET"] == "0" else "cpu"
OBJECTS: list[tuple[Shape, int]] = [
    (Cylinder((0, 0, 0), 50.0, 100.0), 0),
    (Sphere((5, 5, 5), 20.0), 2),
    (Box((10, 0, 0), (30.0, 20.0, 10.0), (0.3, 0.2, 0.1)), 1),
    (Ellipsoid((0, 0, 20), (10.0, 20.0, 30.0), (1, 2, 3)), 0),
    (Cone((-10, 0, 0), (20.0, 0.0), 40.0, (1, 1, 1)), 3),
]
COMPILE = """
from triton.backends.compiler import GPUTarget
from triton.compiler import ASTSource, compile
from phantomgen.ops.trace import gpu

TYPES = dict.fromkeys(("origins", "directions", "maps", "ends", "out"), "*fp64")
TYPES |= {"kinds": "*i64", "materials": "*i64"}
for target in GPUTarget("cuda", 80, 32), GPUTarget("hip", "gfx942", 64):
    types = {name: TYPES.get(name, "i32") for name in gpu._trace.arg_names} | {"BLOCK": "constexpr"}
    text = compile(ASTSource(gpu._trace, types, {"BLOCK": 128}), target=target).asm
    print("atomic" if "atom" in text["ptx" if target.backend == "cuda" else "amdgcn"] else "plain")
"""


@pytest.fixture(scope="module")
def gpu():
    pytest.importorskip("triton")
    from phantomgen.ops.trace import gpu

    return gpu


def traced(gpu, origins: np.ndarray, directions: np.ndarray, objects, count: int, background: int = -1) -> np.ndarray:
    rays = (torch.tensor(a, dtype=torch.float64, device=DEVICE) for a in (origins, directions))
    return gpu.trace_on_device(*rays, solids_of(objects), count, background).cpu().numpy()


@pytest.mark.parametrize("background", [-1, 4])
def test_agrees_with_sorted_events(gpu, background: int) -> None:
    rng = np.random.default_rng(2)
    origins, directions = rng.normal(size=(48, 3)) * 60, rng.normal(size=(48, 3)) * 200
    found = traced(gpu, origins, directions, OBJECTS, 5, background)
    expected = [trace_one(o, d, solids_of(OBJECTS), 5, background) for o, d in zip(origins, directions, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_axis_parallel_rays(gpu) -> None:
    """Along an axis of a cylinder and a box, inside faces that belong to them, and beside them."""
    objects = [(Cylinder((0, 0, 0), 5.0, 10.0), 0), (Box((20, 0, 0), (4, 4, 4)), 1)]
    origins = np.array([[0, 0, -50.0], [5.1, 0, -50], [20, -2, -50], [20, 2, -50], [20, 0, 0]])
    directions = np.tile([0, 0, 100.0], (5, 1))
    found = traced(gpu, origins, directions, objects, 2)
    np.testing.assert_allclose(found, [[10, 0], [0, 0], [0, 4], [0, 0], [0, 2]], atol=1e-12)


def test_no_rays_and_no_shapes(gpu) -> None:
    assert traced(gpu, np.empty((0, 3)), np.empty((0, 3)), OBJECTS, 5).shape == (0, 5)
    nothing = traced(gpu, np.zeros((2, 3)), np.array([[3.0, 4, 0], [0, 0, 1]]), [], 2, 1)
    np.testing.assert_allclose(nothing, [[0, 5], [0, 1]])


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        (Torus((0, 0, 0), 5.0, 1.0), "tori, meshes"),
        (Union((Sphere((0, 0, 0), 1), Sphere((1, 0, 0), 1))), "unions, cuts"),
    ],
)
def test_refuses_what_only_the_cpu_traces(gpu, shape: Shape, words: str) -> None:
    with pytest.raises(InputError, match=words):
        traced(gpu, np.zeros((1, 3)), np.ones((1, 3)), [(shape, 0)], 1)


def test_the_kernel_compiles_for_gpus(tmp_path) -> None:
    pytest.importorskip("triton")
    settings = {"TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)}
    found = subprocess.run(
        [sys.executable, "-c", COMPILE], env={**os.environ, **settings}, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.split() == ["plain", "plain"]
