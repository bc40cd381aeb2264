"""Tables of what happens to photons in materials, from xraylib."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from phantomgen.ops.photon_transport.inputs import LOWEST, Crossings
from spectra.elements.attenuation import attenuation_parts, scattering_functions
from spectra.elements.constants import ELECTRON_REST_ENERGY, PLANCK_LIGHT
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.beam_quality import air_absorption

_STEP = 0.1  # keV; K edges are as wide in the tables
_X_COUNT = 1024
_ANGLES = 400  # of the mean energy of recoil electrons
_MM2 = 100.0  # mm^2 in a cm^2


def crossings_of(materials: Sequence[Material], highest: float) -> Crossings:
    """Tabulate collisions of photons up to an energy.

    Parameters
    ----------
    materials : with compositions
    highest : energy [keV]

    Returns
    -------
    tables

    Raises
    ------
    InputError
        When a material has no composition.
    """
    stated = []
    for material in materials:
        if material.composition is None or material.density is None:
            raise InputError(
                f"dose needs the composition and density of material {material.name!r}, which is given by coefficients"
            )
        stated.append((material.composition, material.density))
    energy = np.arange(0, int(np.ceil(highest / _STEP)) + 2) * _STEP
    known = np.maximum(energy, LOWEST)
    x = np.linspace(0, (highest + 1) / PLANCK_LIGHT, _X_COUNT)
    parts = np.stack([attenuation_parts(composition, known) * density / 10 for composition, density in stated])
    total = parts.sum(axis=1)
    photoelectric, compton = parts[:, 0] / total, parts[:, 1] / total
    functions = [scattering_functions(composition, x) for composition, _ in stated]
    incoherent = np.stack([own for own, _ in functions])
    coherent = np.stack([_integral_over_squares(squared, x) for _, squared in functions])
    recoil = np.stack([_recoil_share(known, x, row) for row in incoherent])
    return Crossings(
        step=_STEP,
        total=total,
        photoelectric=photoelectric,
        compton=photoelectric + compton,
        transferred=total * (photoelectric + compton * recoil),
        largest=total.max(axis=0),
        air=air_absorption(known) * _MM2,
        x_step=float(x[1]),
        incoherent=incoherent,
        coherent=coherent,
    )


def _integral_over_squares(values: Float[np.ndarray, " x"], x: Float[np.ndarray, " x"]) -> Float[np.ndarray, " x"]:
    """Integral over x^2 from 0 on."""
    return np.concatenate([[0.0], np.cumsum(np.diff(x**2) * (values[1:] + values[:-1]) / 2)])


def _recoil_share(
    energy: Float[np.ndarray, " energy"], x: Float[np.ndarray, " x"], incoherent: Float[np.ndarray, " x"]
) -> Float[np.ndarray, " energy"]:
    """Mean energy of recoil electrons over that of the photon."""
    t = (np.arange(_ANGLES) + 0.5) * 2 / _ANGLES  # 1 - cos(theta)
    k = 1 / (1 + energy[:, None] / ELECTRON_REST_ENERGY * t)
    sent = k**2 * (k + 1 / k - t * (2 - t)) * np.interp(energy[:, None] / PLANCK_LIGHT * np.sqrt(t / 2), x, incoherent)
    return (sent * (1 - k)).sum(axis=1) / sent.sum(axis=1)
