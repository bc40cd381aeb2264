"""Drop in deviance of a further function, whatever material without a K edge the ray passes.

No material follows photoelectric absorption and Compton scattering exactly: water, aluminium and steel differ from them
by more than noise. So each ray is explained by the best of several pairs of functions without an edge in the spectrum,
and a K edge has to explain it better than all of them.
"""

import numpy as np
from jaxtyping import Float

from recon.kedge.edge_likelihood import EdgeLikelihood, Functions, PerRay
from spectra.basis.basis import BasisFunction

# Names of `spectra.elements.named_materials`; pairs of a light and a heavy one span tissues, plastics and metals;
# chosen by hand, not measured.
LIGHT = ("Water, Liquid", "PMMA")
HEAVY = ("cortical bone", "Al", "Fe")
_PLAIN = ("photoelectric", "compton", "material")


def pairs_without_edge(functions: Functions) -> tuple[Functions, ...]:
    """List alternatives to the first two functions of a basis.

    Parameters
    ----------
    functions : a basis

    Returns
    -------
    the basis itself, and with pairs of materials without an edge in place of its first two functions, if these have no
    edge either
    """
    if len(functions) < 2 or not all(f.kind in _PLAIN for f in functions[:2]):
        return (functions,)
    named = {name: BasisFunction("material", composition=name) for name in (*LIGHT, *HEAVY)}
    pairs = [(named[light], named[heavy]) for light in LIGHT for heavy in HEAVY]
    return functions, *((*pair, *functions[2:]) for pair in pairs if pair != functions[:2])


def deviance_drops(likelihood: EdgeLikelihood, functions: Functions, further: BasisFunction) -> PerRay:
    """Compute the drop in deviance from the best pair without a further function to the best pair with it.

    Parameters
    ----------
    likelihood : likelihood of the rays
    functions : the basis so far
    further : the further function

    Returns
    -------
    drop in deviance of every ray, 0 where the line integral of the further function would have to be negative
    """
    before, each = _best_deviances(likelihood, functions)
    after = before
    for i, others in enumerate(pairs_without_edge(functions)):
        deviance, lengths = likelihood.deviances((*others, further))
        after = np.fmin(after, np.where(lengths[:, -1] > 0, _finite(deviance), each[:, i]))
    return before - after


def _best_deviances(likelihood: EdgeLikelihood, functions: Functions) -> tuple[PerRay, Float[np.ndarray, "ray pair"]]:
    """Deviance of every ray with the pair that explains it best, and with each pair."""
    each = np.stack([_finite(likelihood.deviances(f)[0]) for f in pairs_without_edge(functions)], axis=1)
    return each.min(axis=1), each


def _finite(deviance: PerRay) -> PerRay:
    """Deviances, infinite where the fit of line integrals did not converge."""
    return np.where(np.isfinite(deviance), deviance, np.inf)
