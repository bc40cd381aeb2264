import numpy as np

from recon.phases.first_phases import changes_beyond_noise


def some_phases(changing: float, noise: float = 0.001, phases: int = 6):
    """A ball of even density, half of which changes from phase to phase in the second basis; and where it changes."""
    z, y, x = np.meshgrid(*[np.arange(-8.0, 8.0)] * 3, indexing="ij")
    ball, part = z**2 + y**2 + x**2 < 36, (z**2 + y**2 + x**2 < 25) & (x > 0)
    volumes = np.tile(0.02 * ball, (phases, 2, 1, 1, 1))
    volumes[:, 1] += changing * np.linspace(0, 1, phases)[:, None, None, None] * part
    noisy = volumes + np.random.default_rng(0).normal(0, noise, volumes.shape) * ball
    return volumes, noisy.astype(np.float32), part


def test_what_rests_is_the_mean_of_all_phases():
    truth, noisy, _ = some_phases(0.0)
    mean, differences = changes_beyond_noise(noisy, 256.0)
    np.testing.assert_array_equal(mean, noisy.mean(axis=0))
    error, before = np.square(mean + differences - truth).mean(), np.square(noisy - truth).mean()
    assert error < 1.1 * before / len(noisy)


def test_what_changes_far_beyond_noise_stays():
    truth, noisy, part = some_phases(0.2)
    mean, differences = changes_beyond_noise(noisy, 256.0)
    wanted = (truth - truth.mean(axis=0))[:, 1, part]
    assert np.square(differences[:, 1, part] - wanted).mean() < 0.02 * np.square(wanted).mean()
    assert np.square(differences[:, 0]).mean() < 1e-3 * np.square(noisy[:, 0] - mean[0]).mean()


def test_phases_without_noise_or_an_object_are_left_as_they_are():
    volumes = some_phases(0.0, noise=0.0)[0].astype(np.float32)
    mean, differences = changes_beyond_noise(volumes, 256.0)
    assert np.abs(mean + differences - volumes).max() < 1e-8
    mean, differences = changes_beyond_noise(0 * volumes, 256.0)
    assert not mean.any()
    assert not differences.any()
