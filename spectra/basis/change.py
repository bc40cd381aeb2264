"""Bases from sets of materials, and coefficients from one basis to another."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import Composition
from spectra.elements.element_sums import added, amounts_of, curve
from spectra.errors import InputError

# Singular values below this part of the largest are rounding.
_LEAST_SINGULAR = 1e-7
# Residuals below this are rounding: one basis spans the other.
_EXACT = 1e-9


@dataclass(frozen=True, eq=False)
class BasisChange:
    """Linear map from coefficients in one raw basis to coefficients in another.

    Parameters
    ----------
    matrix : coefficients of each old function in the new basis
    residuals : rms of what each old function loses over the rms of the function, over the detected spectrum
    """

    matrix: Float[np.ndarray, "old new"]
    residuals: Float[np.ndarray, " old"]

    @property
    def exact(self) -> bool:
        """True when the new basis spans the old one."""
        return bool((self.residuals < _EXACT).all())

    def coefficients(self, old: Float[np.ndarray, "... old"]) -> Float[np.ndarray, "... new"]:
        """Convert coefficients or line integrals to the new basis; they may become negative.

        Parameters
        ----------
        old : coefficients [1/mm] or line integrals in the old basis, (..., M)

        Returns
        -------
        values in the new basis, (..., N)
        """
        return old @ self.matrix


def basis_change(
    old: Basis, new: Basis, energy: Float[np.ndarray, " energy"], weights: Float[np.ndarray, " energy"]
) -> BasisChange:
    """Compute the change from one raw basis to another.

    It is exact where the new basis spans the old one; else it is a least-squares fit.

    Parameters
    ----------
    old, new : raw bases
    energy, weights : detected spectrum, energies [keV] and photons

    Returns
    -------
    matrix and residuals of the change

    Raises
    ------
    InputError
        When functions of the new basis are linearly dependent over the spectrum.
    """
    root = np.sqrt(np.asarray(weights, dtype=np.float64) / np.sum(weights))
    before, after = old.evaluate(energy) * root, new.evaluate(energy) * root
    size = np.linalg.norm(after, axis=1)
    if not (size > 0).all():
        raise InputError(
            f"basis function {new.names[int(np.argmin(size))]!r} vanishes over the whole detected spectrum"
        )
    solution, _, rank, _ = np.linalg.lstsq((after / size[:, None]).T, before.T, rcond=_LEAST_SINGULAR)
    if rank < len(new):
        raise InputError(f"the basis functions {', '.join(new.names)} cannot be told apart over the detected spectrum")
    matrix = solution.T / size
    residuals = np.linalg.norm(before - matrix @ after, axis=1) / np.linalg.norm(before, axis=1)
    return BasisChange(matrix, residuals)


def svd_functions(
    compositions: Mapping[str, Composition],
    count: int,
    energy: Float[np.ndarray, " energy"],
    weights: Float[np.ndarray, " energy"],
) -> tuple[BasisFunction, ...]:
    """Compute the functions ``svd1``, ``svd2``, ... that describe a set of materials best.

    Parameters
    ----------
    compositions : of the materials, by name
    count : number of functions
    energy, weights : detected spectrum, energies [keV] and photons

    Returns
    -------
    the first `count` singular vectors of the materials' attenuation curves, each curve scaled to 1, all in the norm of
    the spectrum; orthonormal in it, with positive mean. Each is a combination of the materials, so it has a value at
    every energy, and K edges where the materials have them

    Raises
    ------
    InputError
        When the materials do not span so many functions.
    """
    parts = [amounts_of(composition) for composition in compositions.values()]
    if not 1 <= count <= len(parts):
        raise InputError(f"{len(parts)} materials give 1 to {len(parts)} functions, not {count}")
    root = np.sqrt(np.asarray(weights, dtype=np.float64) / np.sum(weights))
    curves = np.stack([curve(amounts, energy) for amounts in parts]) * root
    sizes = np.linalg.norm(curves, axis=1)
    mixing, values, functions = np.linalg.svd(curves / sizes[:, None], full_matrices=False)
    rank = int((values > _LEAST_SINGULAR * values[0]).sum())
    if rank < count:
        raise InputError(f"the curves of {', '.join(compositions)} span {rank} functions, not {count}")
    found = []
    for i in range(count):
        sign = 1.0 if functions[i] @ root >= 0 else -1.0
        factors = sign * mixing[:, i] / (values[i] * sizes)
        amounts = added(zip(parts, factors.tolist(), strict=True))
        found.append(BasisFunction("svd", composition=amounts, name=f"svd{i + 1}"))
    return tuple(found)
