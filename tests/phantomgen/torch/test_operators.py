"""Operators for torch: gradients against finite differences, fast kernels against plain torch in float64."""

import numpy as np
import pytest
import torch

import phantomgen.torch as pt
from phantomgen.geometry.panel import Curvature, Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.project import differentiable, pose_gradient
from phantomgen.ops.project import project as project_arrays
from phantomgen.ops.project.reference import matrix_of_view
from phantomgen.ops.project.torch_pair import pose_gradient_on_device
from spectra.errors import GeometryError, InputError
from spectra.transmission import Transmission

GRID = Grid((3, 4, 5), (1.3, 0.9, 1.1), (-1.1, -1.4, -2.3))
VECTORS = ("source", "panel_center", "column_step", "row_step")


def circle(pitch: float = 1.3, panel: tuple[int, int] = (3, 4)) -> Geometry:
    """Views whose rays keep away from the diagonals, where their main axis changes."""
    return Geometry.circular(15.0, 30.0, np.array([0.21, 1.9, 4.5]), Panel(*panel, pitch))


def tilted() -> Geometry:
    rng = np.random.default_rng(5)
    geometry = circle()
    return Geometry(
        **{name: getattr(geometry, name) + 0.2 * rng.normal(size=(3, 3)) for name in VECTORS}, panel=geometry.panel
    )


def parallel() -> Geometry:
    geometry = circle(1.2)  # at 1.3, shadows are as wide as voxels, where the width of a beam has a kink
    return Geometry.parallel(
        -geometry.source / 15.0, geometry.panel_center, geometry.column_step, geometry.row_step, geometry.panel
    )


def inside() -> Geometry:
    """Sources and panels within the grid, where rays begin and end between the layers."""
    panel = Panel(3, 4, 0.4)
    steps = {"column_step": np.array([[0.02, 0.41, 0.0]]), "row_step": np.array([[0.05, 0.0, -0.37]])}
    return Geometry(np.array([[1.4, 0.15, 0.1]]), np.array([[-1.3, 0.1, 0.2]]), **steps, panel=panel)


GEOMETRIES = {"circle": circle(), "wide": circle(4.1), "tilted": tilted(), "parallel": parallel(), "inside": inside()}
geometries = pytest.mark.parametrize("geometry", GEOMETRIES.values(), ids=GEOMETRIES)


def with_vectors(geometry: Geometry, *vectors: torch.Tensor) -> pt.TensorGeometry:
    named = dict(zip(VECTORS, vectors, strict=False))
    direction = vectors[4] if geometry.is_parallel else None
    return pt.TensorGeometry(**named, panel=geometry.panel, ray_direction=direction)


def vectors_of(geometry: Geometry) -> list[torch.Tensor]:
    names = (*VECTORS, "ray_direction") if geometry.is_parallel else VECTORS
    return [torch.tensor(getattr(geometry, name), requires_grad=True) for name in names]


def random(*shape: int, dtype: torch.dtype = torch.float64) -> torch.Tensor:
    return torch.rand(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).to(dtype)


@geometries
def test_plain_torch_has_the_matrix_of_the_definition(geometry: Geometry) -> None:
    volume, panel = random(2, *GRID.shape), geometry.panel
    frames = pt.TensorGeometry.of(geometry).frames().numpy()
    matrix = np.concatenate([matrix_of_view(f, panel.rows, panel.columns, GRID, geometry.is_parallel) for f in frames])
    found = pt.project(volume, GRID, geometry).reshape(2, -1).numpy()
    assert matrix.sum() > 10
    # rays of a parallel beam begin 1e5 mm away, where the definition loses five of 16 digits
    np.testing.assert_allclose(found, volume.reshape(2, -1).numpy() @ matrix.T, rtol=1e-8, atol=1e-8)


@geometries
def test_float32_and_float64_agree(geometry: Geometry) -> None:
    volume = random(2, *GRID.shape)
    exact = pt.project(volume, GRID, geometry)
    found = pt.project(volume.float(), GRID, geometry)
    assert found.dtype == torch.float32
    torch.testing.assert_close(found.double(), exact, rtol=1e-5, atol=1e-5)
    exact = pt.back_project(exact, GRID, geometry)
    torch.testing.assert_close(pt.back_project(found, GRID, geometry).double(), exact, rtol=2e-5, atol=2e-5)


@geometries
def test_gradients_of_the_projector_pair_pass_gradcheck(geometry: Geometry) -> None:
    vectors = vectors_of(geometry)
    volume = random(2, *GRID.shape).requires_grad_()
    images = random(1, len(geometry), geometry.panel.rows, geometry.panel.columns).requires_grad_()
    assert torch.autograd.gradcheck(lambda v, *p: pt.project(v, GRID, with_vectors(geometry, *p)), (volume, *vectors))
    assert torch.autograd.gradcheck(
        lambda y, *p: pt.back_project(y, GRID, with_vectors(geometry, *p)), (images, *vectors)
    )


def test_second_derivatives_in_float64_pass_gradgradcheck() -> None:
    geometry = circle(4.1, (2, 2))[[0]]
    volume = random(1, *GRID.shape).requires_grad_()
    vectors = vectors_of(geometry)
    assert torch.autograd.gradgradcheck(lambda *p: pt.project(volume, GRID, with_vectors(geometry, *p)), vectors)


@geometries
def test_pose_gradients_of_the_kernels_are_those_of_plain_torch(geometry: Geometry) -> None:
    found = {}
    for dtype in (torch.float32, torch.float64):
        vectors = vectors_of(geometry)
        volume = random(2, *GRID.shape, dtype=dtype)
        images = pt.project(volume, GRID, with_vectors(geometry, *vectors))
        weights = random(*images.shape, dtype=dtype)
        forward = torch.autograd.grad((weights * images).sum(), vectors, allow_unused=True)
        back = pt.back_project(weights, GRID, with_vectors(geometry, *vectors))
        backward = torch.autograd.grad((volume * back).sum(), vectors, allow_unused=True)
        found[dtype] = torch.cat([g for g in (*forward, *backward) if g is not None])
    scale = found[torch.float64].abs().max()
    torch.testing.assert_close(found[torch.float32] / scale, found[torch.float64] / scale, rtol=0, atol=1e-5)
    assert scale > 0.1


def test_pose_gradients_for_devices_without_a_kernel_are_those_of_the_kernel() -> None:
    geometry = circle(4.1, (5, 6))
    volume, images = random(2, *GRID.shape, dtype=torch.float32), random(2, 3, 5, 6, dtype=torch.float32)
    frames, spacing = pt.TensorGeometry.of(geometry).frames(), np.array(GRID.spacing)
    views = (frames - frames.new_tensor([[1.0], [0], [0], [0]]) * frames.new_tensor(GRID.origin[::-1])).flip(-1)
    views = views / torch.from_numpy(spacing)
    found = pose_gradient_on_device(volume, images, views, False, spacing, most=60)  # two rows at a time
    expected = pose_gradient(volume.numpy(), images.numpy(), GRID, frames.numpy())
    np.testing.assert_allclose((found.numpy() / spacing)[:, :, ::-1], expected, rtol=1e-6, atol=1e-6)


def smooth_scene(voxels: int = 24) -> tuple[torch.Tensor, Grid]:
    """Blobs a few voxels wide."""
    grid = Grid.cube(voxels, 24.0)
    z, y, x = np.meshgrid(*(grid.axis(name) for name in "zyx"), indexing="ij")
    blobs = [(3, -2, 1, 3.0), (-4, 2, -3, 2.5), (0, 5, 4, 3.5)]
    volume = sum(np.exp(-((x - a) ** 2 + (y - b) ** 2 + (z - c) ** 2) / (2 * w**2)) for a, b, c, w in blobs)
    return torch.tensor(0.02 * volume[None], dtype=torch.float32), grid


@pytest.mark.parametrize(("name", "step"), [("source", 0.2), ("panel_center", 0.1), ("column_step", 2e-3)])
def test_pose_gradients_agree_with_differences_of_the_fast_projector(name: str, step: float) -> None:
    """Of a half sum of squares, the loss of a fit, over a tenth of a pixel; rays along diagonals are among them."""
    volume, grid = smooth_scene()
    geometry = Geometry.circular(60.0, 120.0, np.linspace(0, 2 * np.pi, 8, endpoint=False) + 0.1, Panel(40, 40, 1.2))
    measured = pt.project(volume, grid, pt.TensorGeometry.of(geometry).shifted(0.5, 0.3)).double()

    def loss(poses: pt.TensorGeometry) -> torch.Tensor:
        return ((pt.project(volume, grid, poses).double() - measured) ** 2).sum() / 2

    vectors = vectors_of(geometry)
    which = VECTORS.index(name)
    (gradient,) = torch.autograd.grad(loss(with_vectors(geometry, *vectors)), vectors[which])
    found = torch.zeros_like(gradient)
    for view, axis in np.ndindex(*gradient.shape):
        ends = []
        for sign in (1, -1):
            moved = [vector.detach().clone() for vector in vectors]
            moved[which][view, axis] += sign * step
            ends.append(loss(with_vectors(geometry, *moved)))
        found[view, axis] = (ends[0] - ends[1]) / (2 * step)
    error = (found - gradient).norm() / gradient.norm()
    print(f"{name}: gradient against central differences, relative error {error:.1e}")  # noqa: T201 - the page says how to see it
    assert error < 0.02


def spectrum() -> pt.TensorSpectra:
    return pt.TensorSpectra(1 + 100 * random(3, 7), torch.cat([random(1, 7), random(1, 7).flip(1) ** 2]))


def test_transmission_passes_gradcheck_in_line_integrals_weights_and_columns() -> None:
    lengths = random(2, 2, 3, 2, 4).requires_grad_()
    spectra = spectrum()
    arguments = (lengths, spectra.weights.requires_grad_(), spectra.columns.requires_grad_())

    def counts(lengths: torch.Tensor, weights: torch.Tensor, columns: torch.Tensor) -> torch.Tensor:
        return pt.transmit(lengths, pt.TensorSpectra(weights, columns))

    assert counts(*arguments).shape == (2, 3, 3, 2, 4)
    assert torch.autograd.gradcheck(counts, arguments)
    assert torch.autograd.gradgradcheck(counts, arguments)


def test_transmission_is_that_of_the_simulator() -> None:
    spectra, lengths = spectrum(), 2 * random(2, 3, 4, 5)
    known = Transmission.from_spectrum(spectra.weights.numpy(), spectra.columns.numpy())
    expected = np.moveaxis(known.expected(np.moveaxis(lengths.numpy(), 0, -1)), -1, 1)
    for model in (spectra, known):
        np.testing.assert_allclose(pt.transmit(lengths, model), expected, rtol=1e-12)
    np.testing.assert_allclose(pt.transmit(lengths.float(), known), expected, rtol=1e-5)


def test_pieces_of_rays_give_the_same_as_all_at_once(monkeypatch) -> None:
    lengths, spectra = random(2, 3, 4, 5).requires_grad_(), spectrum()
    arguments = lengths, spectra.weights.requires_grad_(), spectra.columns.requires_grad_()
    whole = pt.transmit(lengths, spectra)
    expected = torch.autograd.grad(whole.square().sum(), arguments)
    monkeypatch.setattr("spectra.differentiable._MOST", 7 * 7)
    pieces = pt.transmit(lengths, spectra)
    torch.testing.assert_close(pieces, whole)
    torch.testing.assert_close(torch.autograd.grad(pieces.square().sum(), arguments), expected)


def test_counts_of_volumes_pass_gradcheck_in_everything() -> None:
    geometry, spectra = circle(4.1, (2, 3)), spectrum()
    vectors = vectors_of(geometry)

    def counts(volume: torch.Tensor, weights: torch.Tensor, *vectors: torch.Tensor) -> torch.Tensor:
        return pt.expected_counts(
            volume, GRID, with_vectors(geometry, *vectors), pt.TensorSpectra(weights, spectra.columns)
        )

    volume = 0.1 * random(2, *GRID.shape)
    arguments = (volume.requires_grad_(), spectra.weights.requires_grad_(), *vectors)
    assert torch.autograd.gradcheck(counts, arguments)


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_any_axes_may_come_before_those_of_a_volume(batch: tuple) -> None:
    geometry = circle()
    volume = random(*batch, *GRID.shape, dtype=torch.float32)
    images = pt.project(volume, GRID, geometry)
    assert images.shape == (*batch, 3, 3, 4)
    assert pt.back_project(images, GRID, geometry).shape == volume.shape
    flat = project_arrays(volume.reshape(-1, *GRID.shape).numpy(), GRID, geometry.ray_frames(), 3, 4)
    np.testing.assert_array_equal(images.reshape(-1, 3, 3, 4), flat)
    lengths = images[..., None, :, :, :].expand(*batch, 2, 3, 3, 4)
    assert pt.transmit(lengths, spectrum()).shape == (*batch, 3, 3, 3, 4)


def test_functional_transforms_of_torch_go_through_the_kernels() -> None:
    volume, weights = random(1, *GRID.shape, dtype=torch.float32), random(1, 3, 3, 4, dtype=torch.float32)
    _, transpose = torch.func.vjp(lambda v: pt.project(v, GRID, circle()), volume)
    torch.testing.assert_close(transpose(weights)[0], pt.back_project(weights, GRID, circle()))


def test_second_derivatives_of_kernels_in_the_volume_exist_and_those_in_poses_are_refused() -> None:
    geometry = circle()
    volume = random(1, *GRID.shape, dtype=torch.float32).requires_grad_()
    images = pt.project(volume, GRID, geometry)
    (first,) = torch.autograd.grad(images.square().sum(), volume, create_graph=True)
    (second,) = torch.autograd.grad(first.square().sum(), volume)
    normal = pt.back_project(pt.project(first.detach(), GRID, geometry), GRID, geometry)
    torch.testing.assert_close(second, 4 * normal, rtol=1e-5, atol=1e-5)
    vectors = vectors_of(geometry)
    loss = pt.project(volume, GRID, with_vectors(geometry, *vectors)).square().sum()
    (first,) = torch.autograd.grad(loss, vectors[0], create_graph=True)
    with pytest.raises(InputError, match="second derivatives in the poses"):
        first.sum().backward()


def test_a_shift_of_the_panel_is_in_pixels_and_poses_come_back() -> None:
    geometry = circle()
    moved = pt.TensorGeometry.of(geometry).shifted(columns=0.5, rows=torch.tensor([0.0, 1.0, 2.0])).numpy()
    expected = geometry.panel_center + 0.5 * geometry.column_step + np.arange(3)[:, None] * geometry.row_step
    np.testing.assert_allclose(moved.panel_center, expected, atol=1e-12)
    assert pt.TensorGeometry.of(geometry).numpy() == geometry
    assert pt.TensorGeometry.of(parallel()).numpy() == parallel()
    assert len(pt.TensorGeometry.of(geometry)[[0, 2]]) == 2


@pytest.mark.wrong_types
def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(InputError, match=r"a volume on a grid of shape \(3, 4, 5\)"):
        pt.project(random(3, 5, 4), GRID, circle())
    with pytest.raises(InputError, match=r"must end with the axes \(3, 3, 4\)"):
        pt.back_project(random(3, 4, 3), GRID, circle())
    with pytest.raises(InputError, match="with 2 columns of the spectral model"):
        pt.transmit(random(3, 3, 3, 4), spectrum())
    with pytest.raises(InputError, match="do not fit"):
        pt.TensorSpectra(random(3, 7), random(2, 6))
    with pytest.raises(InputError, match=r"panel_center has shape \(2, 3\)"):
        pt.TensorGeometry(random(3, 3), random(2, 3), random(3, 3), random(3, 3), Panel(3, 4, 1.0))


def test_a_curved_panel_is_refused() -> None:
    curved = Geometry.circular(15.0, 30.0, np.array([0.21]), Panel(3, 4, 1.3, Curvature(30.0, 2)))
    with pytest.raises(GeometryError, match="a curved panel cannot be used here, only a flat one"):
        pt.TensorGeometry.of(curved)


def test_no_views_give_no_images() -> None:
    views = torch.zeros(0, 4, 3, dtype=torch.float64)
    found = differentiable.forward(random(2, *GRID.shape), views, False, torch.ones(3, dtype=torch.float64), 3, 4)
    assert found.shape == (2, 0, 3, 4)
