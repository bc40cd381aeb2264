"""A curve of materials: basis coefficients as functions of the attenuation at one energy.

One channel measures one number per voxel. Where the materials of an object are known beforehand, and ordered by how
much they attenuate, that number determines all basis coefficients: they lie on a curve from air through fat, water and
bone to metal. Between two neighbouring materials the curve is a straight line, as in a voxel that both share.

References
----------
De Man et al. 2001, doi:10.1109/42.959297: photoelectric absorption and Compton scattering as piecewise linear functions
of the attenuation at 70 keV.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = 70.0  # keV; where materials are ordered; that of De Man et al.

EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True)
class MaterialCurve:
    """Basis coefficients along a chain of materials that begins with vacuum.

    Parameters
    ----------
    materials : names, by attenuation; vacuum is not named
    attenuations : their attenuation at `energy`, ascending, all above 0 [1/mm]
    coefficients : their basis coefficients, one row per material [1/mm]
    energy : [keV]
    """

    materials: tuple[str, ...]
    attenuations: tuple[float, ...]
    coefficients: tuple[tuple[float, ...], ...]
    energy: float = ENERGY

    def __post_init__(self) -> None:
        steps = np.diff((0.0, *self.attenuations))
        if not len(self.materials) == len(self.attenuations) == len(self.coefficients) or not (steps > 0).all():
            raise InputError(
                f"a curve of materials needs different attenuations at {self.energy:g} keV, ascending from 0, got "
                + ", ".join(f"{n} {a:.4g}/mm" for n, a in zip(self.materials, self.attenuations, strict=False))
            )

    @classmethod
    def of(
        cls, materials: Sequence[Material], basis: Basis, energies: EnergyArray, weights: EnergyArray
    ) -> "MaterialCurve":
        """Put materials in order and express them in a basis.

        Parameters
        ----------
        materials : at least one, in any order
        basis : basis functions
        energies, weights : detected spectrum, energies [keV] and photons

        Returns
        -------
        the curve

        Raises
        ------
        InputError
            When there is no material, or two of them attenuate alike at `ENERGY`.
        """
        if not materials:
            raise InputError("a curve of materials needs at least one material")
        there = np.array([ENERGY])
        at = basis.evaluate(there)[:, 0]
        rows = [m.coefficients_in(basis, energies, weights) for m in materials]
        order = sorted(range(len(materials)), key=lambda i: float(rows[i] @ at))
        return cls(
            tuple(materials[i].name for i in order),
            tuple(float(rows[i] @ at) for i in order),
            tuple(tuple(float(v) for v in rows[i]) for i in order),
        )

    def values(self, attenuation: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "basis *shape"]:
        """Compute the coefficients; beyond the last material its line goes on.

        Parameters
        ----------
        attenuation : at `energy`, not negative [1/mm]

        Returns
        -------
        coefficients of each basis [1/mm]
        """
        segment = self._segments(attenuation)
        nodes, rows, slopes = self._tables(attenuation.dtype)
        beyond = attenuation - nodes[segment]
        return np.stack([row[segment] + slope[segment] * beyond for row, slope in zip(rows, slopes, strict=True)])

    def attenuation_of(self, coefficients: Float[np.ndarray, "basis *shape"]) -> Float[np.ndarray, "*shape"]:
        """Compute the attenuation of coefficients on the curve; the inverse of `values`.

        Parameters
        ----------
        coefficients : of each basis [1/mm]

        Returns
        -------
        attenuation at `energy` [1/mm]
        """
        functions = np.linalg.lstsq(np.array(self.coefficients), np.array(self.attenuations), rcond=None)[0]
        return np.tensordot(functions.astype(coefficients.dtype), coefficients, 1)

    def slopes(self, attenuation: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "basis *shape"]:
        """Compute the derivatives of the coefficients in the attenuation; at a material, that towards denser ones.

        Parameters
        ----------
        attenuation : at `energy`, not negative [1/mm]

        Returns
        -------
        derivatives of each basis [no unit]
        """
        segment = self._segments(attenuation)
        return np.stack([slope[segment] for slope in self._tables(attenuation.dtype)[2]])

    def _segments(self, attenuation: Float[np.ndarray, "*shape"]) -> np.ndarray:
        """Number of the straight line of each value."""
        return np.searchsorted(np.array(self.attenuations[:-1], attenuation.dtype), attenuation, side="right")

    def _tables(self, kind: np.dtype) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where each straight line begins; coefficients there and slopes, (basis, segment)."""
        nodes = np.array((0.0, *self.attenuations))
        rows = np.concatenate([np.zeros((1, len(self.coefficients[0]))), np.array(self.coefficients)]).T
        slopes = np.diff(rows, axis=1) / np.diff(nodes)
        return nodes[:-1].astype(kind), rows[:, :-1].astype(kind), slopes.astype(kind)
