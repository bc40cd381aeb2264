"""The method of a run folder is that which the run had."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import yaml

from recon.gaussians.recipe import PLAIN_RECIPES, RECIPES, Stage
from recon.published_methods.paper.recipe import PaperRecipe
from recon.runs.methods import METHODS, method_named
from recon.runs.run_gaussians import GaussianRun
from recon.runs.run_voxels import VoxelRun
from recon.uncertainty.stored_method import stored_method
from recon.voxel.method import CountsMethod, ViewMethod
from spectra.errors import DatasetError, InputError

CHANGED = replace(RECIPES["fast"], seed=7, stages=(Stage(0.5, 1.5), Stage(1.0, 2.0)))
RECIPES_OF_ALL_KINDS = [*RECIPES.values(), *PLAIN_RECIPES.values(), CHANGED, PaperRecipe(steps=300, without=("tv",))]


def written(folder, settings):
    """As `VolumeOutcome.write` does it."""
    plain = {name: list(value) if isinstance(value, tuple) else value for name, value in settings.items()}
    text = yaml.safe_dump(yaml.safe_load(yaml.dump(_lists(plain), sort_keys=False)), sort_keys=False)
    (folder / "recipe.yaml").write_text(text, encoding="utf-8")
    return folder


def _lists(value):
    if isinstance(value, dict):
        return {name: _lists(item) for name, item in value.items()}
    return [_lists(item) for item in value] if isinstance(value, (list, tuple, np.ndarray)) else value


@pytest.mark.parametrize("recipe", RECIPES_OF_ALL_KINDS, ids=lambda r: f"{type(r).__name__}-{getattr(r, 'name', '')}")
def test_recipes_of_gaussians_come_back(recipe, tmp_path):
    assert stored_method(written(tmp_path, asdict(recipe)), 2) == GaussianRun(recipe, 2)


@pytest.mark.parametrize("name", METHODS)
def test_voxel_methods_come_back_and_methods_without_volumes_are_refused(name, tmp_path):
    method = method_named(name, seed=5)
    way = {} if isinstance(method, (CountsMethod, ViewMethod)) else {"pipeline": "image"}
    folder = written(tmp_path, {"method": name} | way | asdict(method))
    if isinstance(method, ViewMethod):
        with pytest.raises(InputError, match="has no volumes"):
            stored_method(folder, 2)
    else:
        assert stored_method(folder, 2) == VoxelRun(method, **way, bases=2)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        (None, DatasetError, "cannot be read as the settings of a run"),
        ("[1, 2", DatasetError, "cannot be read as the settings of a run"),
        ("method: volume", InputError, "holds a given volume"),
        ("name: fast", DatasetError, "has other settings than this version"),
        ("method: sirt\niterations: many\nspeed: 3", DatasetError, "has other settings than this version"),
    ],
)
def test_what_cannot_be_repeated_is_refused(text, error, message, tmp_path):
    if text is not None:
        (tmp_path / "recipe.yaml").write_text(text)
    with pytest.raises(error, match=message):
        stored_method(tmp_path, 2)
