"""Bare X-ray tubes from SpekPy, with bremsstrahlung and lines kept apart.

SpekPy 2 (Poludniowski et al. 2021, doi:10.1002/mp.14945) with its default model `casim`: half-value layers of measured
beams within 5 %. This module imports SpekPy and is itself imported only when a tube is required.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import spekpy
from jaxtyping import Float

from spectra.elements.attenuation import LOWEST_ENERGY, edge_energy
from spectra.errors import InputError
from spectra.source.source import Source

# Spacing of SpekPy's energies [keV].
_STEP = 0.1
_ANODES = {
    "tungsten": ("W", 500.0),
    "molybdenum": ("Mo", 50.0),
    "rhodium": ("Rh", 50.0),
    "silver": ("Ag", 50.0),
}


@lru_cache
def unfiltered_tube(kvp: float, angle: float, anode: str = "tungsten") -> Source:
    """Compute the spectrum of a bare reflection target, per cm^2 and mAs at 1 m.

    Parameters
    ----------
    kvp : tube voltage [kV], from 10 to 500 for tungsten, to 50 for the other anodes
    angle : anode angle [degree], 5 to 25
    anode : ``tungsten``, ``molybdenum``, ``rhodium`` or ``silver``

    Returns
    -------
    the source
    """
    symbol = _checked(kvp, angle, anode)
    tube = _spekpy_tube(kvp, angle, symbol)
    energy, density = _part(tube, lines=False)
    line_bins, line_density = _part(tube, lines=True)
    lines = np.flatnonzero(line_density)
    edge = edge_energy(symbol)
    breaks = (edge,) if edge < kvp else ()
    for value in breaks:
        energy, density = _sharpened(energy, density, value)
    energy, density = _with_ends(energy, density, kvp)
    return Source(energy, density, line_bins[lines], line_density[lines] * _STEP, float(kvp), breaks)


class OffAxis(NamedTuple):
    """Spectra beside the axis over that on the axis, at equal distance from the focal spot, as natural logarithms.

    Parameters
    ----------
    energy, bremsstrahlung : bin middles [keV], and log ratio of each angle
    line_energy, lines : energies of characteristic lines [keV], and log ratio of each angle
    """

    energy: Float[np.ndarray, " bin"]
    bremsstrahlung: Float[np.ndarray, "angle bin"]
    line_energy: Float[np.ndarray, " line"]
    lines: Float[np.ndarray, "angle line"]


def off_axis(kvp: float, angle: float, anode: str, offsets: Float[np.ndarray, " angle"]) -> OffAxis:
    """Compute the change of a bare tube's spectrum with the direction of the rays.

    Parameters
    ----------
    kvp, angle, anode : as for `unfiltered_tube`
    offsets : angles from the axis towards the anode [rad], in the plane of the electrons and the axis

    Returns
    -------
    log ratios to the spectrum on the axis
    """
    tube = _spekpy_tube(kvp, angle, _checked(kvp, angle, anode))
    parts = []
    for lines in (False, True):
        energy, on_axis = _part(tube, lines)
        seen = on_axis > 0
        ratios = [_part(tube, lines, -np.tan(a))[1][seen] / on_axis[seen] / np.cos(a) ** 2 for a in offsets]
        floor = np.finfo(float).tiny
        parts += [energy[seen], np.log(np.maximum(np.array(ratios).reshape(len(offsets), -1), floor))]
    return OffAxis(*parts)


@lru_cache
def _spekpy_tube(kvp: float, angle: float, symbol: str) -> spekpy.Spek:
    """SpekPy's own object."""
    with _interruptible():
        return spekpy.Spek(kvp=kvp, th=angle, dk=_STEP, targ=symbol, physics="casim")


@contextmanager
def _interruptible() -> Iterator[None]:
    """Give back Ctrl-C, which SpekPy takes for a damaged table while it reads one."""
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__context__
        if cause is not None:
            raise KeyboardInterrupt from None
        raise


def _checked(kvp: float, angle: float, anode: str) -> str:
    """Symbol of the anode; refuses what SpekPy would answer with a wrong number."""
    if anode not in _ANODES:
        raise InputError(f"unknown anode {anode!r}: choose from {', '.join(_ANODES)}")
    symbol, highest = _ANODES[anode]
    if not 10 <= kvp <= highest:
        raise InputError(f"a {anode} tube works from 10 to {highest:g} kV, got {kvp:g}")
    if not 5 <= angle <= 25:
        raise InputError(f"the anode angle must lie in 5 .. 25 degrees, got {angle:g}")
    return symbol


def _part(
    tube: spekpy.Spek, lines: bool, tangent: float = 0.0
) -> tuple[Float[np.ndarray, " bin"], Float[np.ndarray, " bin"]]:
    """Bin middles [keV] and photons per keV of the lines alone or of the bremsstrahlung alone.

    `tangent` is that of the angle from the axis, away from the anode.
    """
    x, z = 100 * tangent, 100.0  # cm
    energy, density = tube.get_spectrum(x=x, z=z, edges=False, flu=True, diff=True, char=lines, brem=not lines)
    return np.asarray(energy), np.asarray(density)


def _sharpened(
    energy: Float[np.ndarray, " bin"], density: Float[np.ndarray, " bin"], edge: float
) -> tuple[Float[np.ndarray, " corner"], Float[np.ndarray, " corner"]]:
    """Replace the bins that the anode's K edge smears by a jump, extended linearly from both sides."""
    below, above = energy < edge - 1.5 * _STEP, energy > edge + 1.5 * _STEP
    left = _extended(energy[below][-2:], density[below][-2:], edge)
    right = _extended(energy[above][:2], density[above][:2], edge)
    corners = np.concatenate([energy[below], [edge, edge], energy[above]])
    return corners, np.concatenate([density[below], [left, right], density[above]])


def _with_ends(
    energy: Float[np.ndarray, " bin"], density: Float[np.ndarray, " bin"], kvp: float
) -> tuple[Float[np.ndarray, " corner"], Float[np.ndarray, " corner"]]:
    """Extend half a bin at either end, so that the density reaches the tube voltage."""
    start = max(energy[0] - _STEP / 2, LOWEST_ENERGY)
    first = max(_extended(energy[:2], density[:2], start), 0.0)
    last = max(_extended(energy[-2:], density[-2:], kvp), 0.0)
    return np.concatenate([[start], energy, [kvp]]), np.concatenate([[first], density, [last]])


def _extended(x: Float[np.ndarray, " 2"], y: Float[np.ndarray, " 2"], at: float) -> float:
    """Value of the straight line through two points."""
    return float(y[0] + (y[1] - y[0]) * (at - x[0]) / (x[1] - x[0]))
