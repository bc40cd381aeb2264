"""Colours of bases and of Gaussians, which colour-blind readers can distinguish."""

import numpy as np
from jaxtyping import Float

# hues of Okabe and Ito (2008)
COMPTON, PHOTOELECTRIC = "#56B4E9", "#E69F00"
K_EDGES = ("#D55E00", "#CC79A7", "#009E73", "#F0E442")
_BRIGHTEST = 99.9  # percentile of the coefficients that gets the full colour, so that few outliers do not set it


def basis_colours(names: tuple[str, ...]) -> list[str]:
    """Return the colour of every basis.

    Parameters
    ----------
    names : names of the bases

    Returns
    -------
    colours as ``#RRGGBB``
    """
    edges = [name for name in names if name not in ("compton", "photoelectric")]
    own = {name: K_EDGES[i % len(K_EDGES)] for i, name in enumerate(edges)}
    return [{"compton": COMPTON, "photoelectric": PHOTOELECTRIC, **own}[name] for name in names]


def mixed_colours(
    coefficients: Float[np.ndarray, "gaussian basis"], names: tuple[str, ...]
) -> Float[np.ndarray, "gaussian 3"]:
    """Mix the colours of the bases of each Gaussian by its coefficients.

    Parameters
    ----------
    coefficients : coefficients [1/mm]
    names : names of the bases

    Returns
    -------
    red, green and blue, 0 to 1

    Notes
    -----
    All materials scatter, fewer absorb strongly, and fewest have a K edge. Therefore the colour of the photoelectric
    effect is drawn over that of Compton scattering, and those of K edges over both, with an opacity that grows with the
    coefficient.
    """
    from matplotlib.colors import to_rgb  # noqa: PLC0415 - half a second

    parts = coefficients / brightest(coefficients)
    colours = np.array([to_rgb(colour) for colour in basis_colours(names)])
    mixed = np.tile(np.array(to_rgb(COMPTON)), (len(coefficients), 1))
    last = {"compton": 0, "photoelectric": 1}  # K edges are drawn after both
    for basis in sorted(range(len(names)), key=lambda i: last.get(names[i], 2)):
        opacity = np.clip(parts[:, basis, None], 0.0, 1.0)
        mixed = (1 - opacity) * mixed + opacity * colours[basis]
    return mixed


def brightest(coefficients: Float[np.ndarray, "gaussian basis"]) -> Float[np.ndarray, " basis"]:
    """Return the coefficient of each basis that gets its full colour.

    Parameters
    ----------
    coefficients : coefficients [1/mm]

    Returns
    -------
    a high percentile of each basis [1/mm]; 1 where a basis has no positive one
    """
    if not len(coefficients):
        return np.ones(coefficients.shape[1])
    top = np.percentile(coefficients, _BRIGHTEST, axis=0)
    return np.where(top > 0, top, 1.0)
