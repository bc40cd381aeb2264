"""When something happens, and which view is next."""

from collections.abc import Iterator

import numpy as np

from recon.published_methods.paper.recipe import PaperRecipe


def is_due(step: int, interval: int, recipe: PaperRecipe) -> bool:
    """Whether something that happens at an interval of the paper's steps, until densification ends, happens now."""
    return step < recipe.scaled(recipe.densify_until) and step % recipe.scaled(interval) == 0


def views_in_random_order(count: int, seed: int) -> Iterator[int]:
    """Every view once in random order, again and again."""
    rng = np.random.default_rng([seed, 2])
    while True:
        yield from rng.permutation(count).tolist()
