import numpy as np
import pytest

from spectra.detector.detector import Detector
from spectra.detector.multi_source import MultiSource, added
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Filter, Source


@pytest.fixture(scope="module")
def sources():
    tin = Filter(Material("tin", composition="Sn"), 0.4)
    return Source.tube(80, 1e5), Source.tube(140, 3e5, filters=[tin]), Source.monochromatic(59.5, 2e4)


def test_photons_of_all_sources_add_up_in_any_bins(sources):
    whole = added(sources)
    assert whole.photons == pytest.approx(4.2e5, rel=1e-12)
    assert whole.maximum == 140
    edges = np.unique(np.concatenate([np.random.default_rng(0).uniform(5, 140, 200), [29.2001, 69.525, 80.0]]))
    found, mean = whole.photons_in(edges)
    parts = [source.photons_in(edges) for source in sources]
    np.testing.assert_allclose(found, sum(p for p, _ in parts), rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(found * mean, sum(p * m for p, m in parts), rtol=1e-9, atol=1e-4)


def test_density_jumps_where_the_density_of_a_source_does(sources):
    whole = added(sources[:2])
    for edge in (29.2001, 69.525):
        step = whole.density_at(np.array([edge - 1e-6, edge]))
        parts = sum(source.density_at(np.array([edge - 1e-6, edge])) for source in sources[:2])
        np.testing.assert_allclose(step, parts, rtol=1e-6)
        assert any(abs(b - edge) < 1e-3 for b in whole.breaks)
    assert 80.0 in whole.breaks


def test_a_line_of_two_tubes_is_one_line(sources):
    whole = added(sources[:2])
    assert len(whole.line_energy) == len(sources[1].line_energy)
    assert np.diff(whole.line_energy).min() > 0.05
    assert whole.line_photons.sum() == pytest.approx(sum(s.line_photons.sum() for s in sources[:2]))


def test_one_source_is_itself(sources):
    edges = np.linspace(10, 140, 50)
    np.testing.assert_allclose(added(sources[1:2]).photons_in(edges)[0], sources[1].photons_in(edges)[0], rtol=1e-12)


@pytest.mark.parametrize("gauss", [False, True])
def test_channels_count_the_photons_of_their_own_source(sources, gauss):
    detectors = tuple(Detector.photon_counting([20, 50], top=source.maximum) for source in sources[:2])
    several = MultiSource.of({"low": sources[0], "high": sources[1]}, detectors)
    assert several.names == ("low_bin0", "low_bin1", "high_bin0", "high_bin1")
    assert (len(several), several.groups) == (4, (0, 0, 1, 1))
    whole = added(sources[:2])
    breaks = (*several.breaks, *whole.breaks)
    fine = whole.grid(20, 300, breaks)
    grid = Energies.gauss_legendre(20, 140, 12, breaks, whole.line_energy) if gauss else fine
    energies, photons = whole.sampled(grid)
    found = several.response(energies) * photons
    for g, (source, detector) in enumerate(zip(sources[:2], detectors, strict=True)):
        own = detector.response(energies) * source.sampled(grid)[1]
        np.testing.assert_allclose(found[2 * g : 2 * g + 2], own, rtol=1e-9, atol=1e-9)


def test_lists_of_different_lengths_are_refused(sources):
    with pytest.raises(InputError, match="1 sources need as many detectors, got 0"):
        MultiSource.of({"a": sources[0]}, ())
