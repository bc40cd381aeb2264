"""Names and colours of clusters: what they look like says what they are.

Hues are those of Okabe and Ito (2008), which the colour-blind tell apart: greens for tissue and water, yellow for bone,
purple for metal as in SpectralCTGaussians, and one hue per K edge. Of several clusters of a kind the denser, or more
concentrated, ones are stronger. Air is black.
"""

from collections import Counter
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.segmentation.features import SIGNIFICANT
from spectra.basis.basis import pretty

BONE, METAL = 9.5, 21.0  # effective atomic numbers from which on: fat 6, water 7.5, muscle 7.6, bone 11 to 14, iron 26
_FALLBACK = (0.25, 0.8)  # kappa from which on, where there is no atomic number
_HUES = {"soft tissue": "#009E73", "bone-like": "#F0E442", "metal": "#CC79A7"}
_EDGE_HUES = ("#D55E00", "#56B4E9", "#E69F00", "#0072B2", "#999999")
_WHITE = 0.55  # how far the palest is on the way to white


@dataclass(frozen=True)
class Kind:
    """What a cluster looks like.

    Parameters
    ----------
    group : ``soft tissue``, ``bone-like``, ``metal``, or the name of a K edge
    hue : its colour
    """

    group: str
    hue: str


def kind_of(features: Float[np.ndarray, " feature"], atomic_number: float, edge_names: tuple[str, ...]) -> Kind:
    """By the largest K-edge part where that is significant, else by the effective atomic number."""
    parts = features[2:]
    if parts.size and parts.max() > SIGNIFICANT:
        column = int(parts.argmax())
        return Kind(pretty(edge_names[column]), _EDGE_HUES[column % len(_EDGE_HUES)])
    bone, metal = (BONE, METAL) if np.isfinite(atomic_number) else _FALLBACK
    value = atomic_number if np.isfinite(atomic_number) else float(features[1])
    group = "soft tissue" if value < bone else "bone-like" if value < metal else "metal"
    return Kind(group, _HUES[group])


def names_of(kinds: list[Kind]) -> list[str]:
    """Group names, numbered where a group has several clusters; clusters are in order."""
    sizes = Counter(kind.group for kind in kinds)
    seen: Counter[str] = Counter()
    names = []
    for kind in kinds:
        seen[kind.group] += 1
        names.append(kind.group if sizes[kind.group] == 1 else f"{kind.group} {seen[kind.group]}")
    return names


def colours_of(kinds: list[Kind]) -> Float[np.ndarray, "cluster 3"]:
    """RGB between 0 and 1; clusters are in order, the palest of a kind first."""
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
    return np.array([int(text[i : i + 2], 16) for i in (1, 3, 5)]) / 255
