"""Energy grids: contiguous bins with one node each.

A spectrum is stored as photons per bin, never as point samples: tungsten's K lines make point sampling on 64 nodes err
by several per cent in the log-projection. Bins end at every K edge, threshold and tube voltage, so that all functions
of energy are smooth inside a bin, and a characteristic line has a narrow bin of its own.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

# Half width of a line's bin [keV]: far below what attenuation resolves, far above rounding.
_LINE_HALF_WIDTH = 0.01
# Two cuts closer than this are one [keV].
_SAME = 1e-6

EdgeArray = Float[np.ndarray, " energy_plus_1"]
FinerEdges = Float[np.ndarray, " finer_plus_1"]
EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True, eq=False)
class Energies:
    """Contiguous energy bins.

    Parameters
    ----------
    edges : bin edges, ascending [keV]
    nodes : the energy inside each bin that stands for it [keV]; `Source.sampled` moves it to the fluence mean
    gauss : the nodes are Gauss-Legendre nodes and the bin widths their weights
    """

    edges: EdgeArray
    nodes: EnergyArray
    gauss: bool = False

    def __post_init__(self) -> None:
        edges = np.ascontiguousarray(self.edges, dtype=np.float64)
        nodes = np.ascontiguousarray(self.nodes, dtype=np.float64)
        if edges.ndim != 1 or len(edges) < 2 or not np.isfinite(edges).all() or edges[0] < 0:
            raise InputError("an energy grid needs at least two finite edges, none negative")
        if (np.diff(edges) <= 0).any():
            raise InputError(f"energy edges must ascend, but {_first_descent(edges)}")
        if nodes.shape != (len(edges) - 1,):
            raise InputError(f"{len(edges) - 1} energy bins need as many nodes, got {nodes.shape}")
        if not ((nodes >= edges[:-1]) & (nodes <= edges[1:])).all():
            raise InputError("every energy node must lie in its bin")
        object.__setattr__(self, "edges", edges)
        object.__setattr__(self, "nodes", nodes)

    @classmethod
    def midpoint(cls, low: float, high: float, count: int) -> "Energies":
        """Create `count` equal bins with nodes in the middle.

        Parameters
        ----------
        low, high : limits of the grid [keV]
        count : number of bins

        Returns
        -------
        the grid
        """
        _check_range(low, high, count)
        return cls.from_edges(np.linspace(low, high, count + 1))

    @classmethod
    def from_edges(cls, edges: EdgeArray) -> "Energies":
        """Create bins with nodes in the middle.

        Parameters
        ----------
        edges : bin edges, ascending [keV]

        Returns
        -------
        the grid
        """
        edges = np.asarray(edges, dtype=np.float64)
        return cls(edges, (edges[:-1] + edges[1:]) / 2)

    @classmethod
    def snapped(
        cls, low: float, high: float, count: int, breaks: Iterable[float] = (), lines: Iterable[float] = ()
    ) -> "Energies":
        """Create about `count` equal bins such that every break is an edge and every line has a narrow bin.

        Breaks and lines outside ``low .. high`` are ignored.

        Parameters
        ----------
        low, high : limits of the grid [keV]
        count : approximate number of bins
        breaks : energies that become edges [keV]
        lines : energies of lines [keV]

        Returns
        -------
        the grid
        """
        _check_range(low, high, count)
        cuts = _cuts(low, high, breaks)
        width = (high - low) / count
        parts = [np.linspace(a, b, max(1, round((b - a) / width)) + 1)[:-1] for a, b in pairwise(cuts)]
        edges = np.concatenate([*parts, [high]])
        return cls.from_edges(_with_line_bins(edges, np.asarray(cuts), lines))

    @classmethod
    def gauss_legendre(
        cls, low: float, high: float, per_interval: int, breaks: Iterable[float] = (), lines: Iterable[float] = ()
    ) -> "Energies":
        """Create Gauss-Legendre nodes in every interval between breaks and line bins.

        The weights of the rule sum to the interval and interlace with its nodes (Chebyshev, Markov, Stieltjes), so
        they serve as bin widths and the bins stay contiguous.

        Parameters
        ----------
        low, high : limits of the grid [keV]
        per_interval : nodes in each interval
        breaks : energies that bound intervals [keV]
        lines : energies of lines [keV]

        Returns
        -------
        the grid
        """
        _check_range(low, high, per_interval)
        bins = _line_bins(low, high, np.asarray(_cuts(low, high, breaks)), lines)
        cuts = _cuts(low, high, [*breaks, *(edge for _, *pair in bins for edge in pair)])
        node, weight = np.polynomial.legendre.leggauss(per_interval)
        fraction = np.concatenate([[0.0], np.cumsum(weight) / 2])
        edges, nodes = [np.array([low])], []
        narrow = {(start, line) for line, start, _ in bins}
        for a, b in pairwise(cuts):
            line = next((e for start, e in narrow if start == a), None)
            edges.append(np.array([b]) if line else np.append(a + (b - a) * fraction[1:-1], b))
            nodes.append(np.array([line]) if line else a + (b - a) * (1 + node) / 2)
        return cls(np.concatenate(edges), np.concatenate(nodes), gauss=True)

    @classmethod
    def single(cls, energy: float) -> "Energies":
        """Create a grid of one energy; its bin starts there, so that a threshold of the same energy counts it.

        Parameters
        ----------
        energy : the energy [keV]

        Returns
        -------
        the grid
        """
        return cls(np.array([energy, energy + _SAME]), np.array([energy], dtype=np.float64))

    def __len__(self) -> int:
        return len(self.nodes)

    def __repr__(self) -> str:
        return f"Energies({len(self)} bins, {self.edges[0]:g}..{self.edges[-1]:g} keV)"

    @property
    def widths(self) -> EnergyArray:
        """Bin widths [keV]."""
        return np.diff(self.edges)


def _check_range(low: float, high: float, count: int) -> None:
    """Refuse empty ranges and grids without bins."""
    if not 0 <= low < high < np.inf:
        raise InputError(f"an energy range must ascend from at least 0, got {low:g} .. {high:g} keV")
    if count < 1:
        raise InputError(f"an energy grid needs at least one bin, got {count}")


def _cuts(low: float, high: float, breaks: Iterable[float]) -> list[float]:
    """Range ends and the breaks between them, ascending, near-duplicates dropped."""
    cuts = [float(low)]
    for value in sorted(float(b) for b in breaks):
        if cuts[-1] + _SAME < value < high - _SAME:
            cuts.append(value)
    return [*cuts, float(high)]


def _line_bins(
    low: float, high: float, cuts: Float[np.ndarray, " cut"], lines: Iterable[float]
) -> list[tuple[float, float, float]]:
    """(line, lower edge, upper edge) of the bins around lines, kept clear of cuts and of each other."""
    inside = np.array(sorted({float(line) for line in lines if low <= line <= high}))
    bins = []
    for line in inside:
        others = np.concatenate([inside[inside != line], cuts])
        others = others[others != line]
        half = min(_LINE_HALF_WIDTH, np.abs(others - line).min() / 3)
        # A line exactly on a cut belongs to the bin above it, as a threshold counts energies at or above it.
        lower = line if line in cuts and line < high else line - half
        bins.append((float(line), float(lower), float(min(line + half, high))))
    return bins


def _with_line_bins(edges: EdgeArray, cuts: Float[np.ndarray, " cut"], lines: Iterable[float]) -> FinerEdges:
    """Edges with a narrow bin around every line; ordinary edges inside such a bin give way."""
    bins = _line_bins(edges[0], edges[-1], cuts, lines)
    for _, lower, upper in bins:
        edges = edges[((edges <= lower) | (edges >= upper)) | np.isin(edges, cuts)]
    return np.unique(np.concatenate([edges, *([lower, upper] for _, lower, upper in bins)]))


def _first_descent(edges: EdgeArray) -> str:
    """Words for the first place where edges do not ascend."""
    i = int(np.argmax(np.diff(edges) <= 0))
    return f"edge {i + 1} is {edges[i + 1]:g} keV after {edges[i]:g} keV"
