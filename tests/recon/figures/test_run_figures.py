import subprocess
import sys

import numpy as np
import pytest
from scipy import ndimage

from phantomgen.dataset.spectral_model import Spectra
from phantomgen.display.figures import dataset_energies as channel_figure
from phantomgen.geometry.voxel_grid import Grid
from recon.figures import run_figures as figures
from spectra.basis.basis import Basis, BasisFunction

NAMES = ("photoelectric", "compton", "kedge_63.3")
GRID = Grid.cube(24, 48.0)


def read_png_size(path):
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")


def read_csv(path):
    return np.genfromtxt(path.with_suffix(".csv"), delimiter=",", names=True, deletechars="")


def disc(x0, y0, radius):
    z, y, x = np.meshgrid(*(GRID.axis(a) for a in "zyx"), indexing="ij")
    return ((x - x0) ** 2 + (y - y0) ** 2 < radius**2) * (np.abs(z) < 18.0)


@pytest.fixture(scope="module")
def truth():
    body, strong, weak = disc(0, 0, 20), disc(10, 4, 5), disc(-8, -10, 5)
    return np.stack([0.002 * body, 0.02 * body, 0.02 * strong + 0.01 * weak]).astype(np.float32)


@pytest.fixture(scope="module")
def volumes(truth):
    noise = np.random.default_rng(0).normal(scale=2e-4, size=truth.shape)
    return (ndimage.gaussian_filter(truth, (0, 0.5, 0.5, 0.5)) + noise).astype(np.float32)


@pytest.mark.parametrize("plane", ["axial", "coronal"])
def test_slices_with_truth_are_one_column_wide(tmp_path, volumes, truth, plane):
    path = tmp_path / "new" / "slices.png"
    figures.basis_slices(volumes, truth, NAMES, GRID, path, plane)
    assert read_png_size(path)[0] == 1050


def test_slices_without_truth_and_of_nothing_are_drawn(tmp_path, volumes):
    figures.basis_slices(volumes, None, NAMES, GRID, tmp_path / "a.png")
    assert read_png_size(tmp_path / "a.png")[1] > 300
    empty = np.zeros((1, 1, 1, 1))
    figures.basis_slices(empty, empty, ("compton",), Grid.cube(1, 2.0), tmp_path / "b.png")
    figures.profiles({"result": empty}, empty, ("compton",), Grid.cube(1, 2.0), tmp_path / "c.png")


def test_a_basis_that_the_truth_lacks_is_drawn_without_it(tmp_path, volumes, truth):
    some = truth.copy()
    some[2] = np.nan
    path = tmp_path / "a.png"
    figures.basis_slices(volumes, some, NAMES, GRID, path, left_out=("kedge_50.2",))
    assert read_png_size(path)[0] == 1050
    figures.profiles({"result": volumes}, some, NAMES, GRID, tmp_path / "b.png")


def test_profiles_pass_through_both_regions_of_the_last_basis(tmp_path, volumes, truth):
    start, stop = figures.profile_line(volumes[-1], GRID)
    along = (stop - start) / np.linalg.norm(stop - start)
    for centre in ((10, 4), (-8, -10)):
        offset = np.array([*centre, start[2]]) - start
        assert np.linalg.norm(offset - offset @ along * along) < 1.5
    assert np.abs(np.stack([start, stop])[:, :2]).max() == pytest.approx(24.0)
    figures.profiles({"result": volumes}, truth, NAMES, GRID, tmp_path / "profile.png")
    table = read_csv(tmp_path / "profile.png")
    assert table["kedge_63.3_truth"].max() == pytest.approx(0.02)
    assert np.abs(table["kedge_63.3_result"] - table["kedge_63.3_truth"]).mean() < 2e-3
    assert table["position_mm"][0] == 0


def test_a_profile_without_two_regions_runs_along_x(tmp_path, volumes):
    line = figures.profile_line(volumes[1], GRID)
    np.testing.assert_allclose(line[:, 0], [-24, 24])
    assert line[0, 1] == line[1, 1]
    figures.profiles({"result": volumes}, None, NAMES, GRID, tmp_path / "p.png", line)
    table = read_csv(tmp_path / "p.png")
    assert set(table.dtype.names) >= {"x_mm", "compton_result"}
    assert "compton_truth" not in table.dtype.names
    x = GRID.axis("x")
    values = volumes[1, 12, int(np.argmin(np.abs(GRID.axis("y") - line[0, 1])))]
    inner = (table["x_mm"] > x[0]) & (table["x_mm"] < x[-1])
    assert np.corrcoef(np.interp(table["x_mm"][inner], x, values), table["compton_result"][inner])[0, 1] > 0.99


@pytest.mark.parametrize("channels", [1, 4])
def test_residuals_of_poisson_counts_follow_the_unit_normal(tmp_path, channels):
    names = [f"bin{i}" for i in range(channels)]
    expected = np.tile(np.linspace(900.0, 1200.0, 64 * 96).reshape(64, 96), (channels, 1, 1))
    counts = np.random.default_rng(1).poisson(expected)
    away = np.arange(96) * np.ones((64, 1)) > 20
    figures.residuals(counts, expected, names, tmp_path / "r.png", away)
    table = read_csv(tmp_path / "r.png")
    assert np.abs(table["bin0_all_rays"] - table["unit_normal"]).max() < 0.05
    assert table["bin0_away_from_edges"].sum() * 0.2 == pytest.approx(1, abs=1e-4)
    figures.residuals(np.zeros_like(counts), np.zeros_like(expected), names, tmp_path / "z.png", ~away & away)


def test_the_spectrum_keeps_its_photons(tmp_path):
    edges = np.array([20.0, 40.0, 59.31, 59.33, 63.3, 90.0, 120.0])
    energy, source = (edges[1:] + edges[:-1]) / 2, np.array([50.0, 80.0, 30.0, 20.0, 60.0, 10.0])
    response = np.array([[1.0, 1, 1, 1, 0, 0], [0, 0, 0, 0, 0.9, 0.8]])
    basis = Basis((BasisFunction("photoelectric"), BasisFunction("step", edge_energy=63.3)))
    limits = np.array([20.0, 63.3]), np.array([63.3, 120.0])
    spectra = Spectra(energy, edges, source, response, basis, basis.evaluate(energy), ("low", "high"), *limits)
    figures.spectrum(spectra, tmp_path / "s.png")
    table = read_csv(tmp_path / "s.png")
    np.testing.assert_allclose(table["low_counts"] + table["high_counts"], source * response.sum(axis=0))
    display = channel_figure._display_bins(edges, response)
    assert 63.3 in display
    assert np.diff(display).max() < 1.5
    np.testing.assert_allclose(channel_figure._per_keV(source, edges, display) @ np.diff(display), source.sum())


def test_a_single_energy_is_drawn(tmp_path):
    one = np.ones(1)
    path, basis = tmp_path / "mono.png", Basis((BasisFunction("compton"),))
    figures.spectrum(
        Spectra(60 * one, np.array([59.99, 60.01]), one, one[None], basis, one[None], ("all",), one, one), path
    )
    assert path.stat().st_size > 5000


def test_convergence_writes_every_step(tmp_path):
    seconds = np.linspace(0, 10, 60)
    path = tmp_path / "c.png"
    figures.convergence(seconds, 1 + np.exp(-seconds), path)
    table = read_csv(path)
    np.testing.assert_allclose(table["seconds"], seconds, rtol=1e-5)
    np.testing.assert_allclose(table["running_mean"][5:-5], 1 + np.exp(-seconds[5:-5]), rtol=0.02)
    figures.convergence(np.ones(1), np.ones(1), tmp_path / "one.png")


def test_a_figure_without_a_file_is_shown_by_notebooks(tmp_path, volumes, truth, monkeypatch):
    monkeypatch.chdir(tmp_path)
    figure = figures.basis_slices(volumes, truth, NAMES, GRID)
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert [ax.get_title() for ax in figure.axes[:4] if ax.get_title()] == ["truth", "result", "result − truth"]
    assert len(figures.profiles({"result": volumes}, truth, NAMES, GRID).axes) == len(NAMES)
    assert figures.convergence(np.ones(9), np.ones(9)).axes[0].get_xlabel() == "time [s]"
    assert not list(tmp_path.iterdir())


def test_the_same_numbers_give_the_same_file(tmp_path):
    seconds = np.linspace(0, 1, 9)
    first, second = (tmp_path / f"{i}.png" for i in range(2))
    for path in (first, second):
        figures.convergence(seconds, seconds + 1, path)
    assert first.read_bytes() == second.read_bytes()


def test_importing_the_module_does_not_import_matplotlib():
    heavy = {"matplotlib", "skimage", "torch"}
    code = (
        f"import recon.evaluation.metrics, recon.figures.run_figures, sys; sys.exit(bool({heavy} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
