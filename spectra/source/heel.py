"""The heel effect: rays towards the anode leave it at a smaller angle, so that it absorbs more of them.

SpekPy's model gives the spectrum in any direction. Over the directions of one panel the logarithm of its ratio to the
spectrum on the axis is a sum of very few products, one factor depending on energy and one on direction. Such a product
acts like a sheet of absorber whose thickness changes over the panel. A sheet of anode material would be the obvious one
but does poorly, as lines arise deeper in the anode than bremsstrahlung of the same energy does; so the curves come from
a singular value decomposition, weighted with the spectrum behind the filters, with values of their own at the lines.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from spectra.errors import InputError
from spectra.source.source import Source

# Weighted rms error of a spectrum's logarithm, over any direction of the panel, down to which curves are added.
TOLERANCE = 3e-3
# Most curves, also where the tolerance is missed.
_MOST_CURVES = 3
# SpekPy computes so many directions; between them amplitudes are splines.
_ANGLES = 17
# Rays must leave the anode at this angle or more [degree]: below, its roughness decides, which no model has.
LEAST_TAKE_OFF = 1.0
# Within this of a line a curve has the line's value [keV]: half a line's bin in an energy grid.
_AT_LINE = 0.0101
# Bremsstrahlung below this part of the most there is, and lines below this part of all photons, are left out.
_LEAST = 1e-9


@dataclass(frozen=True, eq=False)
class Curve:
    """Function of energy without unit: linear between corners, with separate values at lines.

    Parameters
    ----------
    energy, value : corners [keV]
    line_energy, line_value : characteristic lines [keV]
    """

    energy: Float[np.ndarray, " corner"]
    value: Float[np.ndarray, " corner"]
    line_energy: Float[np.ndarray, " line"]
    line_value: Float[np.ndarray, " line"]

    def attenuation(self, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " energy"]:
        """Evaluate the curve; constant beyond the corners.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        values without unit
        """
        out = np.interp(energy, self.energy, self.value)
        for line, value in zip(self.line_energy, self.line_value, strict=True):
            out[np.abs(energy - line) <= _AT_LINE] = value
        return out


@dataclass(frozen=True, eq=False)
class Heel:
    """Spectrum of a tube in all directions of a panel: on the axis times exp(-sum_i curve_i(E) amplitude_i(angle)).

    Parameters
    ----------
    curves : functions of energy
    angles, amplitudes : directions of the fit [rad], and the amplitudes there
    error : largest weighted rms error of the spectrum's logarithm over these directions
    """

    curves: tuple[Curve, ...]
    angles: Float[np.ndarray, " angle"]
    amplitudes: Float[np.ndarray, "curve angle"]
    error: float

    def amplitudes_at(self, angles: Float[np.ndarray, "..."]) -> Float[np.ndarray, "curve ..."]:
        """Interpolate the amplitudes at other directions between the outermost ones.

        Parameters
        ----------
        angles : directions from the axis towards the anode [rad]

        Returns
        -------
        amplitudes, (curve, ...)
        """
        return CubicSpline(self.angles, self.amplitudes, axis=1)(angles)


def heel_of(source: Source, kvp: float, angle: float, anode: str, low: float, high: float) -> Heel:
    """Fit the heel effect over the directions of a panel.

    Parameters
    ----------
    source : the tube behind its filters, as weight of energies
    kvp, angle, anode : tube voltage [kV], anode angle [degree], and anode as for `Source.tube`
    low, high : outermost angles from the axis towards the anode [rad], which include 0

    Returns
    -------
    curves, amplitudes and error

    Raises
    ------
    InputError
        When rays to the edge of the panel leave the anode at too small an angle.
    """
    from spectra.source.tube import off_axis  # noqa: PLC0415 - SpekPy takes a second to import

    take_off = angle - np.rad2deg(high)
    if take_off < LEAST_TAKE_OFF:
        raise InputError(
            f"for the heel effect rays must leave the anode at {LEAST_TAKE_OFF:g} degree or more, but those to the "
            f"panel's edge at +z leave it at {take_off:.2g}: use a larger anode angle, a smaller panel or a longer sdd"
        )
    angles = np.unique([*np.linspace(min(low, -1e-3), max(high, 1e-3), _ANGLES), 0.0])
    found = off_axis(kvp, angle, anode, angles)
    density = source.density_at(found.energy)
    seen = density > _LEAST * density.max()
    lit = source.line_photons > _LEAST * source.photons
    photons = np.append(density[seen] * (found.energy[1] - found.energy[0]), source.line_photons[lit])
    logs = np.concatenate([found.bremsstrahlung[:, seen], found.lines[:, lit]], axis=1)
    weights = np.sqrt(photons / photons.sum())
    u, size, shape = np.linalg.svd(logs * weights, full_matrices=False)
    for count in range(1, _MOST_CURVES + 1):
        sign = np.where(shape[:count] @ weights > 0, -1.0, 1.0)  # amplitudes that weaken the beam are positive
        amplitudes, curves = u[:, :count] * size[:count] * sign, -shape[:count] * sign[:, None] / weights
        error = float(np.linalg.norm((amplitudes @ curves + logs) * weights, axis=1).max())
        if error <= TOLERANCE:
            break
    continuum = int(seen.sum())
    return Heel(
        tuple(Curve(found.energy[seen], c[:continuum], found.line_energy[lit], c[continuum:]) for c in curves),
        angles,
        amplitudes.T,
        error,
    )
