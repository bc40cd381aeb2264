"""Every scene that comes with the program: complete, inside the panel and the volume, and traceable."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from phantomgen.geometry.curved_panel import ray_directions
from phantomgen.ops.trace import trace
from phantomgen.scene.file.scene_file import SceneFile, preset_names, preset_summaries
from phantomgen.scene.scan import load_scene
from phantomgen.scene.schema import MaterialModel
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from phantomgen.simulation.forward_model.energy_grids import basis_warnings, fit_warnings, material_fit

DOCS = Path(__file__).parents[3] / "docs"
FEW_VIEWS = ("geometry.views=4", "geometry.test_views=1")


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_is_whole(name: str) -> None:
    time = ("time.phases=null",) if SceneFile.preset(name).model.time else ()
    file = SceneFile.preset(name, (*FEW_VIEWS, *time))
    assert file.model.name == name
    assert 20 < len(preset_summaries()[name]) < 160
    assert max(map(len, file.text.splitlines())) <= 120

    scan = load_scene(file)
    scene = scan.scene
    assert coverage_warnings(scan) == []
    assert fit_warnings(scan, material_fit(scan)) == []
    assert basis_warnings(scan) == []
    used = [name for material in file.model.materials.values() for name in _parts(material)]
    objects = file.text.partition("\nobjects:")[2]
    stated = yaml.safe_load(file.text).get("materials", {})  # bodies bring their own tissues
    assert all(m in objects or m in used for m in stated), "a material of no object"

    panel = scan.geometry.panel
    rng = np.random.default_rng(0)
    columns, rows = (rng.uniform(-0.5, n - 0.5, 10) for n in (panel.columns, panel.rows))
    directions = ray_directions(scan.geometry, columns, rows).reshape(-1, 3)
    origins = np.repeat(scan.geometry.source, 100, axis=0)
    lengths = trace(origins, directions, scene.solids, len(scene.materials), scene.background)
    assert np.isfinite(lengths).all()
    assert (lengths >= 0).all()
    assert (lengths.sum(axis=1) <= np.linalg.norm(directions, axis=1) * (1 + 1e-12)).all()
    assert (lengths > 0).any(axis=1).mean() > 0.2


def test_a_basis_of_more_functions_than_channels_is_said() -> None:
    (sentence,) = basis_warnings(load_scene("kedge", ("detector.thresholds=[20, 65]",)))
    assert "2 channels cannot tell the 3 basis functions photoelectric, compton, kedge_63.3 apart" in sentence
    assert "recon fit --bases 2" in sentence


def _parts(material: MaterialModel) -> list[str]:
    """Materials that another one consists of."""
    inflow, solution = material.inflow, material.solution
    return ([] if inflow is None else [inflow.rest, inflow.peak]) + ([] if solution is None else [solution.solvent])


def test_every_preset_has_its_picture_and_its_sources() -> None:
    page = (DOCS / "reference" / "presets.md").read_text(encoding="utf-8")
    sources = page.partition("## Sources")[2]
    for name in preset_names():
        assert f"](../images/presets/{name}.png)" in page, f"add {name} to docs/reference/presets.md"
        assert f"`{name}`" in sources, f"say in docs/reference/presets.md where {name} comes from"
        picture = DOCS / "images" / "presets" / f"{name}.png"
        assert picture.is_file(), f"run python docs/development/make_thumbnails.py {name}"
        assert picture.stat().st_size < 60_000


def test_the_inner_ear_of_the_forbild_head_has_its_air_cells() -> None:
    scan = load_scene("forbild-head", FEW_VIEWS)
    air = [m.name for m in scan.scene.materials].index("air")
    cells = [shape for shape, material in scan.scene.objects if material == air and shape.bounds[0][0] > 50]
    assert len(cells) == 317
    ear = np.array([np.mean(cell.bounds, axis=0) for cell in cells])
    # as listed in the definition: 8.8 cm is the first of a row in the middle, 5.6 cm the last
    assert ear[:, 0].max() == pytest.approx(88)
    assert ear[:, 0].min() == pytest.approx(56)
    gaps = np.linalg.norm(ear[:, None] - ear[None], axis=2)[~np.eye(317, dtype=bool)]
    assert gaps.min() == pytest.approx(4.0, abs=1e-4), "cells touch each other"
    # 3.46 mm between rows, half a step of 2 mm along them: the nearest cell of another row is 4 mm away, too
    in_ear = ((ear - np.array([91, 0, 0])) / [42, 18, 18]) ** 2
    assert (in_ear.sum(axis=1) < 1).all()


def test_the_hip_metals_are_within_their_standards() -> None:
    model = SceneFile.preset("metal-hip").model
    ranges = {  # mass fractions: ASTM F136 and ASTM F75
        "titanium_alloy": {"Al": (0.055, 0.065), "V": (0.035, 0.045), "Fe": (0, 0.0025), "O": (0, 0.0013)},
        "cobalt_alloy": {"Cr": (0.27, 0.30), "Mo": (0.05, 0.07), "Si": (0, 0.01), "Mn": (0, 0.01)},
    }
    for name, elements in ranges.items():
        composition = model.materials[name].composition
        assert isinstance(composition, dict)
        assert sum(composition.values()) == pytest.approx(1)
        assert all(low <= composition[element] <= high for element, (low, high) in elements.items())
