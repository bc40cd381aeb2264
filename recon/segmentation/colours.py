"""Names and colours of clusters, which show the kind of material.

Hues are those of Okabe and Ito (2008), which colour-blind readers can distinguish: green for tissue and water, yellow
for bone, purple for metal as in SpectralCTGaussians, and one hue per K edge. Of several clusters of a kind, those of
higher density or concentration have stronger colours. Air is black.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.segmentation.features import SIGNIFICANT
from spectra.basis.basis import pretty

BONE, METAL = 9.5, 21.0  # least effective atomic numbers: fat 6, water 7.5, muscle 7.6, bone 11 to 14, iron 26
_FALLBACK = (0.25, 0.8)  # no unit; least kappa of bone and metal, where there is no atomic number; our choice
_HUES = {"soft tissue": "#009E73", "bone-like": "#F0E442", "metal": "#CC79A7"}
_EDGE_HUES = ("#D55E00", "#56B4E9", "#E69F00", "#0072B2", "#999999")
_WHITE = 0.55  # part of white in the palest colour of a kind; our choice


@dataclass(frozen=True)
class Kind:
    """Kind of material of a cluster.

    Parameters
    ----------
    group : ``soft tissue``, ``bone-like``, ``metal``, or the name of a K edge
    hue : its colour as ``#RRGGBB``
    """

    group: str
    hue: str


def kind_of(features: Float[np.ndarray, " feature"], atomic_number: float, edge_names: tuple[str, ...]) -> Kind:
    """Determine the kind of a material: by its largest K-edge part where it is significant, else by its atomic number.

    Parameters
    ----------
    features : rho, kappa, f_K of each K edge
    atomic_number : effective atomic number; NaN where unknown, then kappa is used
    edge_names : names of the K-edge functions

    Returns
    -------
    kind of material
    """
    parts = features[2:]
    if parts.size and parts.max() > SIGNIFICANT:
        column = int(parts.argmax())
        return Kind(pretty(edge_names[column]), _EDGE_HUES[column % len(_EDGE_HUES)])
    bone, metal = (BONE, METAL) if np.isfinite(atomic_number) else _FALLBACK
    value = atomic_number if np.isfinite(atomic_number) else float(features[1])
    group = "soft tissue" if value < bone else "bone-like" if value < metal else "metal"
    return Kind(group, _HUES[group])


def names_of(kinds: list[Kind]) -> list[str]:
    """Create names of clusters: that of the group, with a number where a group has several clusters.

    Parameters
    ----------
    kinds : kinds of the clusters, in order

    Returns
    -------
    names
    """
    sizes = Counter(kind.group for kind in kinds)
    seen: Counter[str] = Counter()
    names = []
    for kind in kinds:
        seen[kind.group] += 1
        names.append(kind.group if sizes[kind.group] == 1 else f"{kind.group} {seen[kind.group]}")
    return names


def colours_of(kinds: list[Kind]) -> Float[np.ndarray, "cluster 3"]:
    """Create colours of clusters: the hue of the group, mixed with white for all but its last cluster.

    Parameters
    ----------
    kinds : kinds of the clusters, in order

    Returns
    -------
    RGB, 0 to 1
    """
    sizes = Counter(kind.group for kind in kinds)
    seen: Counter[str] = Counter()
    colours = np.zeros((len(kinds), 3))
    for row, kind in zip(colours, kinds, strict=True):
        count = sizes[kind.group]
        pale = 0.0 if count == 1 else _WHITE * (1 - seen[kind.group] / (count - 1))
        seen[kind.group] += 1
        row[:] = (1 - pale) * _rgb(kind.hue) + pale
    return colours


def _rgb(text: str) -> np.ndarray:
    """RGB, 0 to 1, of ``#RRGGBB``."""
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255
