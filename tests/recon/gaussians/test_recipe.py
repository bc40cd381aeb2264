"""What a recipe makes of the number of views."""

import pytest

from recon.gaussians.recipe import BEST, FAST, Recipe, Stage


@pytest.mark.parametrize(
    ("recipe", "views", "voxels"),
    [(FAST, 10, 1.0), (FAST, 75, 1.0), (FAST, 120, 0.925), (FAST, 10_000, 0.9), (BEST, 75, 0.9), (BEST, 180, 0.9)],
)
def test_gaussians_are_closer_with_many_views(recipe, views, voxels):
    assert recipe.distance(views) == pytest.approx(voxels, abs=1e-3)


def test_the_prior_lets_go_of_edges_as_steps_grow():
    assert Recipe(steps_along_edges=18).prior_along_edges(75) == pytest.approx(0.24)
    assert Recipe(steps_along_edges=18).prior_along_edges(180) == pytest.approx(0.1)
    assert Recipe(steps_along_edges=18).prior_along_edges(4) == 1


@pytest.mark.parametrize(("views", "steps"), [(200, 200), (75, 75), (30, 75), (10, 40), (1, 4)])
def test_few_views_are_used_more_often(views, steps):
    assert FAST.steps(views) == [steps]


def test_every_stage_has_its_sweeps_and_at_least_one_step():
    recipe = Recipe(stages=(Stage(1.0, 0.5), Stage(0.5, 2.0), Stage(0.5, 1e-9)), views_per_step=3)
    assert recipe.steps(75) == [12, 50, 1]
