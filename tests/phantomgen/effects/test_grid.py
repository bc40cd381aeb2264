"""Anti-scatter grids: primary and scattered signal against the same scan without one."""

import numpy as np
import pytest

import phantomgen
from phantomgen.effects import AntiScatterGrid
from phantomgen.scene.scan import load_scene
from spectra.errors import SceneError

TINY = ["geometry.views=2", "geometry.test_views=0", "panel={rows: 8, columns: 8, pitch: 25.6}", "noise=false"]
KINDS = {"compton": "{type: compton}", "kernel": "{type: kernel, ratio: 0.3, width: 60}"}


def counts(*effects: str) -> np.ndarray:
    scene = phantomgen.load("kedge-small", [*TINY, *(f"effects.{effect}" for effect in effects)])
    with phantomgen.make(scene) as dataset:
        return dataset.load().astype(float)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.slow
def test_a_grid_passes_its_parts_of_primary_and_scattered_photons(kind):
    plain, with_scatter = counts(), counts(f"scatter={KINDS[kind]}")
    found = counts(f"scatter={KINDS[kind]}", "grid={primary: 0.7, scatter: 0.1}")
    assert found == pytest.approx(0.7 * plain + 0.1 * (with_scatter - plain), rel=1e-5)


def test_a_grid_without_scatter_costs_photons_and_changes_no_log_projection():
    scene = phantomgen.load("kedge-small", [*TINY, "effects.grid={primary: 0.7, scatter: 0}"])
    with phantomgen.make(scene) as grid, phantomgen.make(phantomgen.load("kedge-small", TINY)) as plain:
        assert grid.flat == pytest.approx(0.7 * plain.flat, rel=1e-5)
        assert grid.line_integrals(0) == pytest.approx(plain.line_integrals(0), abs=1e-5)


@pytest.mark.parametrize(("parts", "words"), [((0.0, 0.1), "primary photons"), ((0.7, 1.1), "scattered photons")])
def test_impossible_parts_are_refused(parts, words):
    with pytest.raises(ValueError, match=words):
        AntiScatterGrid(*parts)


def test_a_scene_names_the_key():
    with pytest.raises(SceneError, match=r"effects\.grid\.primary"):
        load_scene("kedge-small", ["effects.grid={primary: 1.2, scatter: 0.1}"])
