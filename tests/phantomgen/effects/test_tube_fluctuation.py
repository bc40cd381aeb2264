"""Tube output that varies: its statistics, what a file tells, and that nothing else depends on it."""

import numpy as np
import pytest

from phantomgen.dataset.reader import open_dataset
from phantomgen.effects import TubeOutput
from phantomgen.effects.random_streams import Stream
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from spectra.errors import InputError, SceneError

TINY = ["geometry.views=6", "geometry.test_views=1", "panel.rows=8", "panel.columns=8", "panel.pitch=25.6"]
TINY += ["volume.voxels=8", "flats=4", "noise=false"]


def test_factors_are_normal_around_one():
    drawn = TubeOutput(0.02).factors(5, Stream.PROJECTION, 20_000)
    assert abs(drawn.mean() - 1) < 5 * 0.02 / np.sqrt(20_000)
    assert abs(drawn.std() / 0.02 - 1) < 5 / np.sqrt(2 * 20_000)
    assert abs(np.corrcoef(drawn[:-1], drawn[1:])[0, 1]) < 5 / np.sqrt(20_000)


def test_factors_of_a_frame_depend_on_nothing_but_its_key():
    tube = TubeOutput(0.1)
    few, many = (tube.factors(1, Stream.PROJECTION, count) for count in (3, 9))
    np.testing.assert_array_equal(few, many[:3])
    assert not np.isclose(many, tube.factors(1, Stream.FLAT, 9)).any()
    assert not np.isclose(many, tube.factors(2, Stream.PROJECTION, 9)).any()


@pytest.mark.parametrize("sigma", [-0.1, 0.3])
def test_impossible_outputs_are_refused(sigma):
    with pytest.raises(InputError, match="must lie in 0"):
        TubeOutput(sigma)


@pytest.mark.parametrize("recorded", [True, False])
@pytest.mark.slow
def test_counts_are_scaled_and_the_file_tells_by_how_much_where_it_may(tmp_path, recorded):
    settings = ["effects.tube_output.sigma=0.1", f"effects.tube_output.recorded={str(recorded).lower()}"]
    scans = {"steady": load_scene("kedge-small", TINY), "varying": load_scene("kedge-small", [*TINY, *settings])}
    for name, scan in scans.items():
        simulate(scan, tmp_path / f"{name}.h5")
    factors = TubeOutput(0.1).factors(scans["varying"].seed, Stream.PROJECTION, 7)
    with open_dataset(tmp_path / "steady.h5") as steady, open_dataset(tmp_path / "varying.h5") as varying:
        ratio = varying.load() / steady.load()
        np.testing.assert_allclose(ratio, np.broadcast_to(factors[:, None, None, None], ratio.shape), rtol=1e-6)
        told = factors if recorded else np.ones(7)
        np.testing.assert_allclose(varying.exposure, np.broadcast_to(told[:, None], varying.exposure.shape))


def test_a_scene_names_what_is_wrong():
    with pytest.raises(SceneError, match=r"effects\.tube_output\.sigma"):
        load_scene("kedge-small", ["effects.tube_output.sigma=0.5"])
