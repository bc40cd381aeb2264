"""What a further function saves on a ray, whatever material without a K edge the ray passes.

Photoelectric effect and Compton scattering are no exact law of any material: water, aluminium and steel differ from
them by more than noise. So each ray is explained by the best of several pairs of functions without an edge in the
spectrum, and a K edge has to explain it still better.
"""

import numpy as np
from jaxtyping import Float

from recon.kedge.profile_likelihood import EdgeLikelihood, Functions
from spectra.basis.basis import BasisFunction

LIGHT = ("Water, Liquid", "PMMA")
HEAVY = ("cortical bone", "Al", "Fe")
_PLAIN = ("photoelectric", "compton", "material")


def pairs_without_edge(functions: Functions) -> tuple[Functions, ...]:
    """These functions; and with other materials without an edge in place of the first two, where those have none."""
    if len(functions) < 2 or not all(f.kind in _PLAIN for f in functions[:2]):
        return (functions,)
    named = {name: BasisFunction("material", composition=name) for name in (*LIGHT, *HEAVY)}
    pairs = [(named[light], named[heavy]) for light in LIGHT for heavy in HEAVY]
    return functions, *((*pair, *functions[2:]) for pair in pairs if pair != functions[:2])


def best_deviances(
    likelihood: EdgeLikelihood, functions: Functions
) -> tuple[Float[np.ndarray, " ray"], Float[np.ndarray, "ray pair"]]:
    """Deviance of every ray beside the pair that explains it best, and beside each."""
    each = np.stack([_finite(likelihood.deviances(f)[0]) for f in pairs_without_edge(functions)], axis=1)
    return each.min(axis=1), each


def drops(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> tuple[np.ndarray, np.ndarray]:
    """What a further function saves on every ray, beside the pair that is best without it and the one best with it.

    Returns
    -------
    the drop in deviance, 0 where its line integral would have to be negative, and the deviance without it
    """
    before, each = best_deviances(likelihood, functions)
    after = before
    for i, others in enumerate(pairs_without_edge(functions)):
        deviance, lengths = likelihood.deviances((*others, further))
        after = np.fmin(after, np.where(lengths[:, -1] > 0, _finite(deviance), each[:, i]))
    return before - after, before


def _finite(deviance: Float[np.ndarray, " ray"]) -> Float[np.ndarray, " ray"]:
    """Infinite where line integrals were not found."""
    return np.where(np.isfinite(deviance), deviance, np.inf)
