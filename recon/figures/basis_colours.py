"""Colours of Gaussians: what each basis adds to them, in colours that the colour-blind tell apart."""

import numpy as np
from jaxtyping import Float

COMPTON, PHOTOELECTRIC = "#56B4E9", "#E69F00"
K_EDGES = ("#D55E00", "#CC79A7", "#009E73", "#F0E442")
_BRIGHTEST = 99.9  # percentile of coefficients that has the full colour: a few outliers must not pale the rest


def basis_colours(names: tuple[str, ...]) -> list[str]:
    """A colour for every basis."""
    edges = [name for name in names if name not in ("compton", "photoelectric")]
    own = {name: K_EDGES[i % len(K_EDGES)] for i, name in enumerate(edges)}
    return [{"compton": COMPTON, "photoelectric": PHOTOELECTRIC, **own}[name] for name in names]


def mixed_colours(
    coefficients: Float[np.ndarray, "gaussian basis"], names: tuple[str, ...]
) -> Float[np.ndarray, "gaussian 3"]:
    """Red, green and blue from 0 to 1.

    All matter scatters, much less absorbs, and an edge tells most: so the colour of Compton scattering is painted over
    by that of the photoelectric effect, and both by those of K edges, the more the larger their coefficients are.
    """
    from matplotlib.colors import to_rgb  # noqa: PLC0415 - half a second

    parts = coefficients / brightest(coefficients)
    colours = np.array([to_rgb(colour) for colour in basis_colours(names)])
    mixed = np.tile(np.array(to_rgb(COMPTON)), (len(coefficients), 1))
    last = {"compton": 0, "photoelectric": 1}  # K edges are painted after both
    for basis in sorted(range(len(names)), key=lambda i: last.get(names[i], 2)):
        opacity = np.clip(parts[:, basis, None], 0.0, 1.0)
        mixed = (1 - opacity) * mixed + opacity * colours[basis]
    return mixed


def brightest(coefficients: Float[np.ndarray, "gaussian basis"]) -> Float[np.ndarray, " basis"]:
    """Coefficient of each basis that is shown as large; 1 where a basis has none [1/mm]."""
    if not len(coefficients):
        return np.ones(coefficients.shape[1])
    top = np.percentile(coefficients, _BRIGHTEST, axis=0)
    return np.where(top > 0, top, 1.0)
