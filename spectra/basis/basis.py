"""Functions of energy that attenuation is expanded in: mu(x, E) = sum_m B_m(E) alpha_m(x).

B has no unit and alpha is in 1/mm. One raw normalisation holds in files, scores and for positivity; conditioned
functions live inside solvers only. With E_ref = 70 keV and E_n = max(E_ref, E_K):

=============  ==========================================================================================
photoelectric  (E / E_ref)^-3 (Alvarez & Macovski 1976, doi:10.1088/0031-9155/21/5/002, eq. 2)
compton        f_KN(E) / f_KN(E_ref), Klein-Nishina total cross section (same, eq. 3)
step           s((E - E_K) / width) (E / E_n)^-3
sigmoid        s((E - E_K) / width)
element        mu/rho(E) / mu/rho(E_n + 10 eV) of one element
material       mu/rho(E) / mu/rho(E_ref) of one material; water and bone say, in place of the first two
svd            a combination of materials that has no unit either; see `spectra.basis.change.svd_functions`
=============  ==========================================================================================

with s the logistic function, a sharp step for width 0, which is 1 at the edge itself. Coefficients of all kinds but
`svd` are never negative.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from spectra.elements.attenuation import Composition, edge_energy, mass_attenuation
from spectra.elements.constants import ELECTRON_REST_ENERGY
from spectra.elements.element_sums import Amounts, amounts_of, curve, edges_of, from_text, to_text
from spectra.errors import InputError

# Energy [keV] at which basis functions are 1 unless their edge lies above it: in the middle of diagnostic spectra.
REFERENCE_ENERGY = 70.0
# An element's curve is normalised this far above its edge [keV]: beyond the jump of xraylib's tables, 4 eV wide.
_ABOVE_EDGE = 0.010
# Kinds of functions with a K edge, and kinds that are curves of materials.
_EDGE_KINDS = ("sigmoid", "step", "element")
_CURVE_KINDS = ("material", "svd")
KINDS = ("photoelectric", "compton", *_EDGE_KINDS, *_CURVE_KINDS)

EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True)
class BasisFunction:
    """One function of energy.

    Parameters
    ----------
    kind : ``photoelectric``, ``compton``, ``sigmoid``, ``step``, ``element``, ``material`` or ``svd``
    edge_energy : K edge [keV] of a sigmoid, a step or an element; that of `element` where left out
    edge_width : inverse slope 1/gamma of the logistic function [keV]; 0 for a sharp step
    element : symbol; required by kind ``element``
    name : ``photoelectric``, ``compton``, ``kedge_<element or keV>``, or the composition where left out
    composition : of kind ``material``: a name, a formula or mass fractions; amounts of elements for ``svd``
    """

    kind: str
    edge_energy: float | None = None
    edge_width: float = 0.0
    element: str | None = None
    name: str = ""
    composition: Composition | Amounts | None = None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InputError(f"unknown kind of basis function {self.kind!r}: choose from {', '.join(KINDS)}")
        if self.kind in _EDGE_KINDS:
            self._complete_edge()
        elif self.edge_energy is not None or self.element is not None:
            raise InputError(f"a {self.kind} basis function has no edge and no element")
        if (self.composition is not None) != (self.kind in _CURVE_KINDS):
            needs = "needs a" if self.kind in _CURVE_KINDS else "has no"
            raise InputError(f"a {self.kind} basis function {needs} composition")
        object.__setattr__(self, "name", self.name or self._default_name())
        if self.composition is not None and not isinstance(self.composition, tuple):
            object.__setattr__(self, "composition", amounts_of(self.composition))

    def _complete_edge(self) -> None:
        """Check the edge, or take it from the element."""
        if self.element is not None and (self.edge_energy is None or self.kind == "element"):
            object.__setattr__(self, "edge_energy", edge_energy(self.element))
        if self.edge_energy is None:
            missing = "an element" if self.kind == "element" else "an edge energy or an element"
            raise InputError(f"a {self.kind} basis function needs {missing}")
        if self.kind == "element" and self.element is None:
            raise InputError("an element basis function needs an element")
        if not (np.isfinite(self.edge_energy) and self.edge_energy > 0):
            raise InputError(f"the edge energy must be positive, got {self.edge_energy} keV")
        if not 0 <= self.edge_width < np.inf:
            raise InputError(f"the edge width must be finite and not negative, got {self.edge_width} keV")

    def _default_name(self) -> str:
        """The name used in files."""
        if isinstance(self.composition, str):
            return self.composition.strip()
        return self.kind if self.edge_energy is None else f"kedge_{self.element or format(self.edge_energy, 'g')}"

    @property
    def amounts(self) -> Amounts:
        """Elements of a material or a combination of materials; empty for other kinds."""
        return self.composition if isinstance(self.composition, tuple) else ()

    @property
    def breaks(self) -> tuple[float, ...]:
        """Edges, where the function is not smooth [keV]."""
        return edges_of(self.amounts) if self.edge_energy is None else (self.edge_energy,)

    @property
    def edge_slope(self) -> float:
        """Gamma, the inverse of the edge width [1/keV]; infinite for a sharp step."""
        return 1.0 / self.edge_width if self.edge_width > 0 else np.inf

    def normalisation_energy(self, reference: float = REFERENCE_ENERGY) -> float:
        """Return E_n [keV]: the reference energy, or the K edge where that is higher.

        Parameters
        ----------
        reference : E_ref [keV]

        Returns
        -------
        E_n [keV]
        """
        return max(reference, self.edge_energy or 0.0)

    def evaluate(self, energy: EnergyArray, reference: float = REFERENCE_ENERGY) -> EnergyArray:
        """Evaluate the function.

        Parameters
        ----------
        energy : energies [keV]
        reference : E_ref [keV]

        Returns
        -------
        values without unit
        """
        energy = np.asarray(energy, dtype=np.float64)
        above = self.normalisation_energy(reference)
        if self.kind == "photoelectric":
            return (energy / reference) ** -3.0
        if self.kind == "compton":
            return klein_nishina(energy) / klein_nishina(np.array([reference]))[0]
        if self.kind in _CURVE_KINDS:
            values = curve(self.amounts, np.append(energy, reference))
            return values[:-1] / values[-1] if self.kind == "material" else values[:-1]
        if self.kind == "element":
            values = mass_attenuation({str(self.element): 1.0}, np.append(energy, above + _ABOVE_EDGE))
            return values[:-1] / values[-1]
        values = edge_step(energy, float(self.edge_energy or 0.0), self.edge_width)
        return values if self.kind == "sigmoid" else values * (energy / above) ** -3.0


@dataclass(frozen=True)
class Basis:
    """Basis functions in the order of the coefficients.

    Parameters
    ----------
    functions : basis functions with names of their own
    reference_energy : E_ref [keV]
    """

    functions: tuple[BasisFunction, ...]
    reference_energy: float = REFERENCE_ENERGY

    def __post_init__(self) -> None:
        object.__setattr__(self, "functions", tuple(self.functions))
        if not self.functions:
            raise InputError("a basis needs at least one function")
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InputError(f"two basis functions are named {twice[0]!r}")

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "Basis":
        """Create a basis from the columns that `to_dict` returns, as a dataset stores them.

        Parameters
        ----------
        table : columns by name; text may be bytes

        Returns
        -------
        the basis
        """
        names, kinds, elements = (_texts(table[key]) for key in ("basis_name", "basis_kind", "element"))
        compositions = _texts(table.get("basis_composition", [""] * len(names)))
        edges, widths = (np.asarray(table[key], dtype=np.float64) for key in ("edge_energy", "edge_width"))
        functions = tuple(
            BasisFunction(
                kind,
                edge_energy=None if np.isnan(edge) else float(edge),
                edge_width=0.0 if np.isnan(width) else float(width),
                element=element or None,
                name=name,
                composition=from_text(composition) if composition else None,
            )
            for name, kind, element, edge, width, composition in zip(
                names, kinds, elements, edges, widths, compositions, strict=True
            )
        )
        return cls(functions, float(np.asarray(table["reference_energy"])))

    def to_dict(self) -> dict[str, Any]:
        """Return the basis as columns for a file: lists of text and float64 arrays.

        An `edge_energy` of NaN means that a function has no edge. Only bases of materials have the column
        ``basis_composition``.

        Returns
        -------
        columns by name
        """
        compositions = [to_text(f.amounts) for f in self.functions]
        edges = [f.edge_energy for f in self.functions]
        return {
            "basis_name": list(self.names),
            "basis_kind": [f.kind for f in self.functions],
            "edge_energy": np.array([np.nan if edge is None else edge for edge in edges]),
            "edge_width": np.array([np.nan if f.edge_energy is None else f.edge_width for f in self.functions]),
            "element": [f.element or "" for f in self.functions],
            "normalisation_energy": np.array([f.normalisation_energy(self.reference_energy) for f in self.functions]),
            "reference_energy": self.reference_energy,
            **({"basis_composition": compositions} if any(compositions) else {}),
        }

    def __len__(self) -> int:
        return len(self.functions)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the functions."""
        return tuple(f.name for f in self.functions)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Edges, where the functions are not smooth [keV]."""
        return tuple(sorted({edge for f in self.functions for edge in f.breaks}))

    @property
    def signed(self) -> bool:
        """True when coefficients may be negative."""
        return any(f.kind == "svd" for f in self.functions)

    def evaluate(self, energy: EnergyArray) -> Float[np.ndarray, "basis energy"]:
        """Evaluate the raw functions.

        Parameters
        ----------
        energy : energies [keV]

        Returns
        -------
        values without unit, (M, E)
        """
        return np.stack([f.evaluate(energy, self.reference_energy) for f in self.functions])


def klein_nishina(energy: EnergyArray) -> EnergyArray:
    """Compute the total Klein-Nishina cross section per electron, in units of 2 pi r_e^2.

    Computed in float64; the closed form cancels at low energies (relative error 1e-9 at 1 keV, 1e-13 at 20 keV).

    Parameters
    ----------
    energy : photon energies [keV]

    Returns
    -------
    cross sections

    References
    ----------
    Klein & Nishina 1929, Zeitschrift fuer Physik 52, 853-868, doi:10.1007/BF01366453
    """
    a = np.asarray(energy, dtype=np.float64) / ELECTRON_REST_ENERGY
    log_term = np.log1p(2 * a)
    first = (1 + a) / a**2 * (2 * (1 + a) / (1 + 2 * a) - log_term / a)
    return first + log_term / (2 * a) - (1 + 3 * a) / (1 + 2 * a) ** 2


def edge_step(energy: EnergyArray, edge: float, width: float) -> EnergyArray:
    """Evaluate the logistic function s((E - E_K) / width).

    Parameters
    ----------
    energy : energies [keV]
    edge : E_K [keV]
    width : inverse slope 1/gamma [keV]; 0 for a step that is 1 at the edge and above

    Returns
    -------
    values from 0 to 1
    """
    if width == 0:
        return (np.asarray(energy) >= edge).astype(np.float64)
    return expit((np.asarray(energy, dtype=np.float64) - edge) / width)


def pretty(name: str) -> str:
    """Return the name of a basis function as shown in figures and reports.

    Parameters
    ----------
    name : name of the function, such as ``kedge_I``

    Returns
    -------
    such as ``K-edge I``
    """
    if name.startswith("kedge_"):
        what = name.removeprefix("kedge_")
        return f"K-edge {what} keV" if what[:1].isdigit() else f"K-edge {what}"
    return "Compton" if name == "compton" else name


def _texts(values: Sequence[Any] | np.ndarray) -> list[str]:
    """Text, also from the bytes that HDF5 gives."""
    return [v.decode() if isinstance(v, bytes) else str(v) for v in values]
