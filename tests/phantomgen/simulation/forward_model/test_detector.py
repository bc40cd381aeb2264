"""All effects of a detector together: what is measured has the mean that is promised, and scans are complete."""

import numpy as np
import pytest
from support.detector_scenes import counting, frames, integrating, views_of

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.validate import validate
from phantomgen.effects.random_streams import Stream
from phantomgen.simulation.run import simulate
from recon.data.measurements import read_measurements

BOTH = [
    "effects.blur={mtf: 0.3, frequency: 0.4}",
    "effects.gain={sigma: 0.05, columns: 0.02, smooth: 0.05, drift: 0.01}",
    "effects.defects={dead: 0.02, hot: 0.01, rows: [1]}",
]
INTEGRATING = ["effects.electronics={sigma: 200, offset: 4000}", "darks=3"]
LAG = "effects.lag={fractions: [0.05], decays: [3]}"
DEAD_TIME = "detector.dead_time={tau_ns: 100, exposure_ms: 1}"


@pytest.mark.parametrize(
    "scan",
    [
        counting(*BOTH, "flats=40", "geometry.views=3"),
        counting(*BOTH, DEAD_TIME, "flats=40"),
        integrating(*BOTH, *INTEGRATING, "flats=40"),
    ],
    ids=["counts", "dead time", "energies"],
)
def test_the_mean_of_frames_with_noise_is_the_frame_without(scan):
    views = views_of(scan)
    noisy = frames(views, Stream.FLAT, 40)
    quiet = frames(views, Stream.FLAT, 1, noise=False)[0]
    error = noisy - quiet
    stuck = views.detector.mask != 0
    assert abs(error[..., stuck]).max() <= 0.5  # integers
    good = error[..., ~stuck]
    deviation = good.std(axis=0, ddof=1)
    z = good.mean(axis=0) / (deviation / np.sqrt(40))
    # Student's t with 39 degrees of freedom has the variance 39 / 37; light that spreads links some 13 pixels.
    independent = z.size if scan.detector.units == "counts" else z.size / 13
    assert abs(z.mean()) < 5 * np.sqrt(39 / 37 / independent)
    assert z.var() == pytest.approx(39 / 37, abs=5 * np.sqrt(2.2 / independent))


def test_several_panels_with_all_effects_make_a_scan_that_can_be_read(tmp_path):
    lines = "{low: {type: lines, lines: {40: 2000}}, high: {type: lines, lines: {60: 1000, 80: 2000}}}"
    scan = integrating(*BOTH, *INTEGRATING, LAG, f"source={{type: multi_source, sources: {lines}}}")
    simulate(scan, tmp_path / "scan.h5", keep_expected=True)
    assert validate(tmp_path / "scan.h5") == []
    with open_dataset(tmp_path / "scan.h5") as dataset:
        assert dataset.counts.shape[1] == 2
        assert (dataset.dark[~dataset.mask] > 3000).all()
        found = read_measurements(dataset, np.arange(3))
        assert np.isfinite(found.counts).all()
        assert found.counts.min() == 0
        np.testing.assert_array_equal(found.gains == 0, dataset.mask)
        error = dataset.load() - dataset.file["truth/expected"][()]
        assert abs(error[:, dataset.mask]).max() == 0
