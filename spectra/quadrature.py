"""Energy nodes by tolerance: the fewest that give the counts of a box of line integrals.

==========  =======================================================================================================
midpoint    equal steps, a tabulated spectrum sampled in the middle: the usual rule, poor where there are lines
snapped     photons integrated over bins that end at every edge, nodes at the mean energy of the photons
gauss       Gauss-Legendre nodes between the edges, characteristic lines as nodes of their own
compressed  free nodes, weights positive, fitted to `fine` over the box; their columns belong to no single energy
==========  =======================================================================================================

All but the last give the exact open beam; that is within its tolerance, too. Errors are those of log counts relative to
the open beam; time per ray is proportional to the nodes.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis
from spectra.energy.grid import Energies
from spectra.energy.node_reduction import sample_box
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Source
from spectra.transmission import Transmission

RULES = ("midpoint", "snapped", "gauss", "compressed")
# Widest interval of the grid that errors are measured against [keV], and Gauss nodes in each.
FINE_STEP = 0.5
_FINE_NODES = 4
# Step of the spectrum table that the midpoint rule samples [keV]; tube models give it by default.
TABLE_STEP = 0.5
# Far below any feature of a response [keV].
_POINT = 1e-6
# Rays that rules are compared on, and the seed that they are drawn by.
_FRESH_RAYS, _SEED = 2000, 1234
# Most bins of the midpoint rule, and most Gauss nodes between two breaks: bounds of time.
_MOST_BINS, _MOST_PER_INTERVAL = 4096, 64

EnergyArray = Float[np.ndarray, " energy"]


@runtime_checkable
class Response(Protocol):
    """Interface of a detector: counts per photon in each channel, and the energies where they are not smooth."""

    @property
    def names(self) -> tuple[str, ...]:
        """Channel names."""
        ...

    @property
    def breaks(self) -> tuple[float, ...]:
        """Energies where a response jumps or bends [keV]."""
        ...

    def response(self, energies: Energies) -> Float[np.ndarray, "channel energy"]:
        """Return the counts per photon of each energy bin.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        counts per photon, (C, E)
        """
        ...


@dataclass(frozen=True, eq=False)
class Integrand:
    """Integrand of the expected counts over energy: product of photons, response and transmission.

    The transmission is exp(-sum_m columns_m(E) L_m), with L_m the line integral of column m.

    Parameters
    ----------
    source, detector : photons, and the channels that count them
    columns : basis functions, or materials with a composition
    low : lowest energy that the detector counts [keV]
    """

    source: Source
    detector: Response
    columns: Basis | Sequence[Material]
    low: float

    def __post_init__(self) -> None:
        if not 0 < self.low <= self.source.maximum:
            raise InputError(f"no photons are counted from {self.low:g} to {self.source.maximum:g} keV")

    @property
    def breaks(self) -> tuple[float, ...]:
        """Edges of source, detector and columns between `low` and the highest energy [keV]."""
        if isinstance(self.columns, Basis):
            own = self.columns.breaks
        else:
            own = tuple(e for m in self.columns for e in m.k_edges(self.low, self.source.maximum))
        found = {*self.source.breaks, *self.detector.breaks, *own}
        return tuple(sorted(e for e in found if self.low < e < self.source.maximum))

    @cached_property
    def open_beam(self) -> Float[np.ndarray, " channel"]:
        """Expected counts with nothing in the beam."""
        return fine(self).open_beam

    def at(self, energy: EnergyArray) -> Float[np.ndarray, "column energy"]:
        """Evaluate the columns.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        columns, (M, E): no unit for basis functions, [1/mm] for materials
        """
        if isinstance(self.columns, Basis):
            return self.columns.evaluate(energy)
        return np.stack([material.attenuation(energy) for material in self.columns])


@dataclass(frozen=True, eq=False)
class Quadrature:
    """A transmission with few nodes.

    Parameters
    ----------
    transmission : line integrals of the columns to expected counts
    rule : how its nodes were found
    error : worst error of log counts on rays of the box, against `fine`
    """

    transmission: Transmission
    rule: str
    error: float

    def __repr__(self) -> str:
        return f"Quadrature({self.rule}, {len(self)} nodes, error {self.error:.1e})"

    def __len__(self) -> int:
        """Nodes of all channels together."""
        return len(self.transmission.weights)


def cheapest(
    integrand: Integrand,
    box_low: Float[np.ndarray, " column"],
    box_high: Float[np.ndarray, " column"],
    tolerance: float,
    rules: Sequence[str] = RULES,
) -> Quadrature:
    """Find the transmission with the fewest nodes whose log counts err by at most `tolerance` in a box.

    Parameters
    ----------
    integrand : source, detector and columns
    box_low, box_high : smallest and largest line integral of each column
    tolerance : largest error of log counts
    rules : those to try; leave out ``compressed`` where every node must be an energy

    Returns
    -------
    the transmission, its rule and its error

    Raises
    ------
    InputError
        When no rule gets there.
    """
    unknown = sorted(set(rules) - set(RULES))
    if unknown or not rules:
        raise InputError(f"unknown energy rule {(unknown or ['none'])[0]!r}: choose from {', '.join(RULES)}")
    exact = fine(integrand)
    box = exact.checked_box(box_low, box_high)
    rays = _rays(box)
    wanted = exact.log_projection(rays)
    if not tolerance > 0:
        raise InputError(f"the tolerance of energy nodes must be positive, got {tolerance:g}")
    best: Quadrature | None = None
    smallest = np.inf
    for rule in reversed([rule for rule in RULES if rule in rules]):
        for model in _ladder(rule, integrand, exact, box, tolerance):
            if best is not None and len(model.weights) > len(best):
                break
            error = float(np.abs(model.log_projection(rays) - wanted).max())
            smallest = min(smallest, error)
            if error <= tolerance:
                best = Quadrature(model, rule, error)
                break
    if best is None:
        raise InputError(f"energy nodes by {', '.join(rules)} err by {smallest:.1e} at best, not by {tolerance:.1e}")
    return best


def midpoint(integrand: Integrand, count: int, high: float | None = None) -> Transmission:
    """Compute nodes in the middle of `count` equal steps up to `high`.

    The spectrum is a table in steps of `TABLE_STEP`, lines included, interpolated at the nodes. This is how most
    polychromatic models are computed; between nodes a line is lost, on a node it counts for the whole step.

    Parameters
    ----------
    integrand : source, detector and columns
    count : number of steps
    high : upper limit [keV]; the highest energy of the source where left out

    Returns
    -------
    transmission with at most `count` nodes
    """
    top = integrand.source.maximum
    if integrand.source.is_monochromatic:
        return fine(integrand)
    table = top - TABLE_STEP * np.arange(ceil((top - integrand.low) / TABLE_STEP) + 2)[::-1]
    density = integrand.source.photons_in(table)[0] / TABLE_STEP
    nodes = Energies.midpoint(integrand.low, high or top, count).nodes
    photons = np.interp(nodes, (table[:-1] + table[1:]) / 2, density, right=0.0)
    model = _at_points(integrand, nodes, np.where(nodes <= top, photons, 0.0))
    return _with_open_beam(model, integrand.open_beam)


def snapped(integrand: Integrand, step: float) -> Transmission:
    """Compute bins of about `step` keV that end at every edge, with exact photons and mean energies.

    Every characteristic line has a bin of its own.

    Parameters
    ----------
    integrand : source, detector and columns
    step : bin width [keV]

    Returns
    -------
    transmission with one node per bin
    """
    source = integrand.source
    grid = source.grid(integrand.low, max(1, ceil((source.maximum - integrand.low) / step)), integrand.breaks)
    energies, photons = source.sampled(grid)
    weights = integrand.detector.response(energies) * photons
    model = Transmission.from_spectrum(weights, integrand.at(energies.nodes), integrand.detector.names)
    return _with_open_beam(model, integrand.open_beam)


def gauss(integrand: Integrand, per_interval: int) -> Transmission:
    """Compute Gauss-Legendre nodes in every interval between edges; the characteristic lines are nodes of their own.

    Parameters
    ----------
    integrand : source, detector and columns
    per_interval : nodes in each interval

    Returns
    -------
    transmission with these nodes
    """
    return _with_open_beam(_at_points(integrand, *_gauss_nodes(integrand, per_interval)), integrand.open_beam)


def fine(integrand: Integrand) -> Transmission:
    """Compute the reference of this module: Gauss-Legendre nodes between all corners of the spectrum.

    Intervals are at most `FINE_STEP` keV wide. Twice the nodes change log counts by 6e-9, and by 5e-7 where 1e-12 of
    the photons are left.

    Parameters
    ----------
    integrand : source, detector and columns

    Returns
    -------
    transmission with many nodes
    """
    steps = np.arange(integrand.low, integrand.source.maximum, FINE_STEP)
    return _at_points(integrand, *_gauss_nodes(integrand, _FINE_NODES, (*integrand.source.energy, *steps)))


def log_error(
    model: Transmission,
    exact: Transmission,
    box_low: Float[np.ndarray, " column"],
    box_high: Float[np.ndarray, " column"],
) -> float:
    """Compute the worst difference of log counts, relative to the open beam, on corners and random rays of a box.

    Parameters
    ----------
    model : transmission to judge
    exact : transmission to compare with, such as `fine`
    box_low, box_high : smallest and largest line integral of each column

    Returns
    -------
    largest absolute difference
    """
    rays = _rays(exact.checked_box(box_low, box_high))
    return float(np.abs(model.log_projection(rays) - exact.log_projection(rays)).max())


def _rays(box: Float[np.ndarray, "2 column"]) -> Float[np.ndarray, "ray column"]:
    """Rays that no rule was fitted to."""
    return sample_box(box, _FRESH_RAYS, np.random.default_rng(_SEED))


def _ladder(
    rule: str, integrand: Integrand, exact: Transmission, box: Float[np.ndarray, "2 column"], tolerance: float
) -> Iterator[Transmission]:
    """Ever more nodes of one rule."""
    width = integrand.source.maximum - integrand.low
    counts = [1] if integrand.source.is_monochromatic else np.unique(np.geomspace(4, _MOST_BINS, 41).astype(int))
    if rule == "compressed":
        for share in (0.8, 0.3):
            yield exact.compress(box[0], box[1], share * tolerance, thorough=True)[0]
    elif rule == "gauss":
        for count in range(1, _MOST_PER_INTERVAL + 1):
            yield gauss(integrand, count)
    else:
        for count in counts:
            yield midpoint(integrand, int(count)) if rule == "midpoint" else snapped(integrand, width / count)


def _gauss_nodes(
    integrand: Integrand, per_interval: int, breaks: Iterable[float] = ()
) -> tuple[EnergyArray, EnergyArray]:
    """Energies and photons of Gauss-Legendre nodes and of lines, ascending."""
    source = integrand.source
    seen = (source.line_energy >= integrand.low) & (source.line_energy <= source.maximum)
    nodes, photons = source.line_energy[seen], source.line_photons[seen]
    if not source.is_monochromatic:
        grid = Energies.gauss_legendre(integrand.low, source.maximum, per_interval, (*integrand.breaks, *breaks))
        nodes = np.append(nodes, grid.nodes)
        photons = np.append(photons, source.density_at(grid.nodes) * grid.widths)
    order = np.argsort(nodes)
    return nodes[order], photons[order]


def _at_points(integrand: Integrand, nodes: EnergyArray, photons: EnergyArray) -> Transmission:
    """Photons of single energies; an energy on a threshold is counted above it."""
    edges = np.column_stack([nodes, nodes + _POINT]).ravel()
    weights = integrand.detector.response(Energies.from_edges(edges))[:, ::2] * photons
    return Transmission.from_spectrum(weights, integrand.at(nodes), integrand.detector.names)


def _with_open_beam(model: Transmission, counts: Float[np.ndarray, " channel"]) -> Transmission:
    """Scale the weights of each channel to its open beam; a channel without nodes stays blind."""
    sums = model.open_beam
    factors = np.divide(counts, sums, out=np.zeros_like(sums), where=sums > 0)
    return replace(model, weights=model.weights * np.repeat(factors, np.diff(model.starts)))
