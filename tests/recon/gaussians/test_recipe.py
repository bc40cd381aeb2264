"""What a recipe makes of the number of views, and that its page states every number of it."""

import re
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import pytest

from recon.gaussians.recipe import FAST, PLAIN_BEST, PLAIN_FAST, Recipe, Stage
from recon.gaussians.settings import PriorSettings
from spectra.errors import InputError

UNCHOSEN = ("curve", "name", "seed", "held_out")  # what a user gives


def is_group(field):
    return is_dataclass(getattr(Recipe(), field.name, None))


@pytest.mark.parametrize(
    ("recipe", "views", "voxels"),
    [
        (PLAIN_FAST, 10, 1.0),
        (PLAIN_FAST, 75, 1.0),
        (PLAIN_FAST, 120, 0.925),
        (PLAIN_FAST, 10_000, 0.9),
        (PLAIN_BEST, 75, 0.9),
        (PLAIN_BEST, 180, 0.9),
    ],
)
def test_gaussians_are_closer_with_many_views(recipe, views, voxels):
    assert recipe.distance(views) == pytest.approx(voxels, abs=1e-3)


def test_the_prior_lets_go_of_edges_as_steps_grow():
    assert Recipe(steps_along_edges=18).prior_along_edges(75) == pytest.approx(0.24)
    assert Recipe(steps_along_edges=18).prior_along_edges(180) == pytest.approx(0.1)
    assert Recipe(steps_along_edges=18).prior_along_edges(4) == 1


@pytest.mark.parametrize(("views", "steps"), [(200, 200), (75, 75), (30, 75), (10, 40), (1, 4)])
def test_few_views_are_used_more_often(views, steps):
    assert PLAIN_FAST.steps(views) == [steps]
    assert FAST.steps(views) == [3 * steps]  # Gaussians with planes are few, and their steps short


def test_every_stage_has_its_sweeps_and_at_least_one_step():
    recipe = Recipe(stages=(Stage(1.0, 0.5), Stage(0.5, 2.0), Stage(0.5, 1e-9)), views_per_step=3)
    assert recipe.steps(75) == [12, 50, 1]


PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "the_fit.md"
SETTINGS = {"Recipe": Recipe()} | {f.name: getattr(Recipe(), f.name) for f in fields(Recipe) if is_group(f)}


def rows_of(section):
    """Fields and defaults that a table of the page states."""
    text = re.search(rf"^### `?{section}\b.*?(?=^##|\Z)", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert text is not None, f"the page has no section {section}"
    return re.findall(r"^\| `(\w+)` \| `(.+?)` \|", text.group(), re.MULTILINE)


@pytest.mark.parametrize("section", SETTINGS)
def test_the_page_of_the_fit_states_every_setting_with_its_default(section):
    settings = SETTINGS[section]
    found = [(f.name, repr(getattr(settings, f.name))) for f in fields(settings) if not is_group(f)]
    assert rows_of(section) == found


def test_every_setting_says_where_its_value_was_chosen():
    for settings in SETTINGS.values():
        text = " ".join((type(settings).__doc__ or "").split())
        for f in fields(settings):
            said = re.search(rf"(?:^|\s){f.name} : (.*?)(?=\s\w+ : |$)", text)
            assert said is not None, f.name
            if f.name not in UNCHOSEN and not is_group(f):
                assert re.search("measured|by hand|no difference|value of|that of|is that step|large", said[1]), f.name


@pytest.mark.parametrize("group", [name for name in SETTINGS if name != "Recipe"])
def test_settings_refuse_what_is_not_positive(group):
    settings = SETTINGS[group]
    name = fields(settings)[0].name
    with pytest.raises(InputError, match=f"recipe {group} {name} must be positive, got 0"):
        replace(settings, **{name: 0})


def test_a_stride_that_leaves_slabs_out_is_refused():
    with pytest.raises(InputError, match="must have no common factor, so that every slab is used, got 8 and 4"):
        PriorSettings(slab_stride=4)
