"""Effects that contradict the rest of a scene."""

import pytest

from phantomgen.effects.aperture import Aperture
from phantomgen.effects.scatter import ScatterKernel
from phantomgen.scene.scan import load_scene
from spectra.errors import SceneError

PARALLEL = "geometry={type: parallel, distance: 300, views: 4}"


@pytest.mark.parametrize(
    ("effect", "what"),
    [("focal_spot={width: 1.0}", "a focal spot"), ("scatter={type: compton}", "Compton scatter")],
)
def test_effects_of_a_source_point_are_refused_where_rays_are_parallel(effect, what):
    with pytest.raises(SceneError, match=rf"effects\.{effect.partition('=')[0]} - {what} needs a source point"):
        load_scene("kedge-small", [PARALLEL, f"effects.{effect}"])


def test_other_effects_do_with_parallel_rays():
    effects = ["effects.aperture={width: 0.5}", "effects.scatter={type: kernel, ratio: 0.1, width: 20.0}"]
    found = load_scene("kedge-small", [PARALLEL, *effects]).effects
    assert found.aperture == Aperture(0.5, 0.5)
    assert found.scatter == ScatterKernel(0.1, 20.0)
