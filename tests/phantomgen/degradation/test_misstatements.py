"""A stated spectrum of another voltage against the tube of that voltage behind the same filters."""

import numpy as np
import pytest

from phantomgen.degradation.misstatements import tube_ratio, with_voltage
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.energy_grids import reconstructor_spectra
from spectra.errors import InputError

OVERRIDES = ["geometry.views=3"]


@pytest.fixture(scope="module")
def spectra():
    return reconstructor_spectra(load_scene(SceneFile.preset("kedge-small", OVERRIDES)))


@pytest.mark.parametrize("error", [-5.0, 3.0])
def test_filters_cancel(spectra, error):
    file = SceneFile.preset("kedge-small", OVERRIDES)
    voltage, anode = file.model.source.kvp, file.model.source.anode
    other = load_scene(SceneFile.preset("kedge-small", [*OVERRIDES, f"source.kvp={voltage + error}"]))
    wanted = np.asarray(other.source.photons_in(spectra.edges)[0])
    stated, left_out = with_voltage(spectra, voltage, error, anode)
    assert stated.source.sum() == pytest.approx(spectra.source.sum())
    assert stated.source / stated.source.sum() == pytest.approx(wanted / wanted.sum(), abs=2e-5)
    beyond = 0.0 if error < 0 else other.source.photons_in(np.array([spectra.edges[-1], voltage + error]))[0][0]
    assert left_out == pytest.approx(beyond / (wanted.sum() + beyond), rel=0.01)


def test_no_error_is_the_ratio_one(spectra):
    ratio, left_out = tube_ratio(spectra.edges, 140.0, 0.0, "tungsten")
    assert ratio == pytest.approx(1.0)
    assert left_out == 0


def test_a_channel_must_keep_some_photons(spectra):
    with pytest.raises(InputError, match="channel bin3 would count nothing"):
        with_voltage(spectra, 140.0, -70.0, "tungsten")
