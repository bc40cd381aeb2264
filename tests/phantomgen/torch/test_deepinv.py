"""Adapters for DeepInverse, where it is installed: `pip install deepinv`."""

import subprocess
import sys
import warnings

import numpy as np
import pytest
import torch

import phantomgen
import phantomgen.torch as pt
from spectra.errors import InputError


def printed(program: str) -> str:
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()


@pytest.mark.slow
def test_deepinv_is_imported_when_it_is_asked_for_and_its_extra_is_named_where_it_is_missing():
    assert printed("import sys, phantomgen.torch; print('deepinv' in sys.modules)") == "False"
    failing = "try:\n import phantomgen.torch.deepinv\nexcept ImportError as problem:\n print(problem)"
    said = printed(f"import sys\nsys.modules['deepinv'] = None\n{failing}")
    assert said == "adapters for DeepInverse need it: pip install 'spectral-ct[deepinv]'"


@pytest.fixture(scope="module")
def adapters():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of deepinv's own imports
        pytest.importorskip("deepinv", exc_type=ImportError)
        from phantomgen.torch import deepinv
    return deepinv


@pytest.fixture(scope="module")
def model(scan_paths):
    with phantomgen.open(scan_paths[0]) as dataset:
        return pt.ForwardModel.of(dataset)


def random(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(3))


def test_line_integrals_are_linear_physics_with_an_exact_adjoint(adapters, model):
    physics = adapters.ProjectorPhysics(model.grid, model.geometry[[0, 1, 2]])
    volume, images = random(2, 3, *model.grid.shape), random(2, 3, 3, 12, 16)
    torch.testing.assert_close(physics.A(volume), pt.project(volume, model.grid, model.geometry[[0, 1, 2]]))
    assert float(physics.adjointness_test(volume)) < 1e-3 * float((physics.A(volume) ** 2).sum()) ** 0.5
    torch.testing.assert_close((physics.A(volume) * images).sum(), (volume * physics.A_adjoint(images)).sum())
    torch.testing.assert_close(physics(volume), physics.A(volume))


def test_the_pseudoinverse_of_deepinv_finds_the_volume(adapters, model):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        physics = adapters.ProjectorPhysics(model.grid, model.geometry, max_iter=50, tol=1e-6)
        volume = random(1, 1, *model.grid.shape)
        images = physics.A(volume)
        found = physics.A_dagger(images)
    assert (physics.A(found) - images).norm() < 5e-3 * images.norm()  # 50 iterations


def test_counts_are_physics_with_the_gradient_of_torch(adapters, model):
    physics = adapters.ScanPhysics(model, views=[0, 2])
    volume = (0.01 * random(2, 3, *model.grid.shape)).requires_grad_()
    counts = physics.A(volume)
    torch.testing.assert_close(counts, model(volume, [0, 2]))
    cotangent = random(*counts.shape)
    (expected,) = torch.autograd.grad(counts, volume, cotangent)
    torch.testing.assert_close(physics.A_vjp(volume.detach(), cotangent), expected)


def test_noise_of_deepinv_is_that_of_photons(adapters, model):
    import deepinv

    physics = adapters.ScanPhysics(
        model, noise_model=deepinv.physics.PoissonNoise(rng=torch.Generator().manual_seed(1))
    )
    volume = torch.zeros(1, 3, *model.grid.shape)
    mean = physics.A(volume)
    score = (physics(volume) - mean) / mean.sqrt()
    assert abs(float(score.mean())) < 5 / score.numel() ** 0.5
    assert float(score.var()) == pytest.approx(1, abs=5 * (2 / score.numel()) ** 0.5)


def test_scans_are_a_data_set_that_deepinv_accepts(adapters, scan_paths, model):
    pairs = adapters.ScanImages(scan_paths)
    pairs.check_dataset()
    pair = pairs[0]
    np.testing.assert_array_equal(pair["x"], phantomgen.read_truth(scan_paths[0]).volumes)
    expected = adapters.ScanPhysics(model, views=range(4)).A(pair["x"][None])[0]
    assert pair["y"].shape == expected.shape
    air = adapters.ScanPhysics(model, views=range(4)).A(0 * pair["x"][None])[0]
    error, signal = ((pair["y"] / counts).log().abs().mean() for counts in (expected, air))
    assert error < 0.2 * signal  # voxels of 16 mm
    lines = adapters.ScanImages(scan_paths, measured="line_integrals")[0]["y"]
    assert lines.shape == (4, 4, 12, 16)
    np.testing.assert_array_equal(lines[2, 3], pt.ScanSet(scan_paths)[0]["line_integrals"][3, 2])
    with pytest.raises(InputError, match="counts or line_integrals"):
        adapters.ScanImages(scan_paths, measured="logs")
