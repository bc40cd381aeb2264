"""A file that states another spectrum than the one that was used, for tests of how much an error of the model costs."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.spectral_model import Spectra
from spectra.errors import InputError

# Anode angle where a file does not state it [degree]; it cancels in the ratio of two voltages to first order.
_ANODE_ANGLE = 12.0


def tube_ratio(
    edges: Float[np.ndarray, " energy_plus_1"], voltage: float, error: float, anode: str
) -> tuple[Float[np.ndarray, " energy"], float]:
    """Compute what a tube emits at another voltage, over what it emits at the true one; flat filters cancel.

    Parameters
    ----------
    edges : of the energy bins [keV]
    voltage : the true one [kV]
    error : the other one less the true one [kV]
    anode : material of the target

    Returns
    -------
    ratio of each bin, 0 where the tube emits nothing at the true voltage; and photons of the other voltage above the
    last bin, over those of the true one in that bin

    Raises
    ------
    InputError
        When SpekPy has no tube of that anode or voltage.
    """
    from spectra.source.tube import unfiltered_tube  # noqa: PLC0415 - SpekPy only where a tube is wanted

    true, other = (unfiltered_tube(kvp, _ANODE_ANGLE, anode) for kvp in (voltage, voltage + error))
    old, new = (np.asarray(source.photons_in(edges)[0]) for source in (true, other))
    beyond = 0.0
    if voltage + error > edges[-1] and old[-1] > 0:
        beyond = float(other.photons_in(np.array([edges[-1], voltage + error]))[0][0] / old[-1])
    return np.divide(new, old, out=np.zeros_like(new), where=old > 0), beyond


def with_voltage(spectra: Spectra, voltage: float, error: float, anode: str) -> tuple[Spectra, float]:
    """State the spectrum of a tube of another voltage, behind the same filters, with the same number of photons.

    Parameters
    ----------
    spectra : the spectral model
    voltage, error, anode : see `tube_ratio`

    Returns
    -------
    the model, and the part of the photons of the other voltage that lie above its last energy bin and are left out
    """
    ratio, beyond = tube_ratio(spectra.edges, voltage, error, anode)
    left_out = beyond * float(spectra.source[-1])
    return with_source(spectra, ratio), left_out / (left_out + float((spectra.source * ratio).sum()))


def with_source(spectra: Spectra, ratio: Float[np.ndarray, " energy"]) -> Spectra:
    """Multiply the stated spectrum, keeping its number of photons.

    Parameters
    ----------
    spectra : the spectral model
    ratio : factor of each energy bin

    Returns
    -------
    the model with another source

    Raises
    ------
    InputError
        When a channel counts nothing in the new spectrum.
    """
    source = spectra.source * ratio
    changed = replace(spectra, source=source * (spectra.source.sum() / source.sum()))
    empty = [name for name, level in zip(spectra.channels, changed.weights.sum(axis=1), strict=True) if level == 0]
    if empty:
        raise InputError(
            f"with this voltage channel {empty[0]} would count nothing: choose a smaller error of the voltage"
        )
    return changed
