"""Quantities that a volume may hold, their units, and their truth.

All follow exactly from the truth of a dataset, as all are linear in the volume fractions of its materials: basis
coefficients as they are, attenuation at an energy as the sum of coefficients times basis functions, Hounsfield units
from attenuation, and densities from those of the materials; volume fractions are there as they are.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.layout import FRACTION_SCALE
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.true_materials import TrueMaterial
from phantomgen.dataset.truth import Truth
from spectra.elements.attenuation import HIGHEST_ENERGY, LOWEST_ENERGY, atomic_number, mass_fractions
from spectra.errors import InputError
from spectra.materials.material import Material

KINDS = "basis:NAME, mono:KEV, channel:NAME, hu:KEV, density:NAME or fraction:NAME"
WATER = Material("water", composition="Water, Liquid")
_GROUPS = {
    "basis": "basis", "mono": "attenuation", "channel": "attenuation", "hu": "attenuation", "density": "density",
    "fraction": "fraction",
}  # fmt: skip
UNITS = {"basis": "1/mm", "attenuation": "1/mm", "density": "g/cm^3", "fraction": "1"}  # of the truth, by group
_ATTENUATION = {"1/mm": 1.0, "1/cm": 0.1, "1/m": 1e-3}
_DENSITY = {"g/cm^3": 1.0, "g/ml": 1.0, "mg/cm^3": 1e-3, "mg/ml": 1e-3, "kg/m^3": 1e-3}
_FRACTION = {"1": 1.0, "%": 0.01}
_HOUNSFIELD = {"hu": 1.0}
_KNOWN_UNITS = {"basis": _ATTENUATION, "attenuation": _ATTENUATION, "density": _DENSITY, "fraction": _FRACTION}
_ELEMENTS = {  # agents and metals by the names that people use
    "iodine": "I", "gadolinium": "Gd", "gold": "Au", "bismuth": "Bi", "barium": "Ba", "calcium": "Ca", "tungsten": "W",
    "ytterbium": "Yb", "tantalum": "Ta", "hafnium": "Hf", "iron": "Fe", "titanium": "Ti", "silver": "Ag",
}  # fmt: skip


@dataclass(frozen=True)
class Quantity:
    """What one volume holds.

    Parameters
    ----------
    kind : ``basis``, ``mono``, ``channel``, ``hu``, ``density`` or ``fraction``
    item : name of a basis function, energy [keV], name or number of a channel, or name of a material
    """

    kind: str
    item: str

    def __str__(self) -> str:
        return f"{self.kind}:{self.item}"

    @property
    def group(self) -> str:
        """Section of ``metrics.json``: ``basis``, ``attenuation``, ``density`` or ``fraction``."""
        return _GROUPS[self.kind]

    @property
    def label(self) -> str:
        """Name of the volume in tables and figures."""
        if self.group == "basis":
            return self.item
        plain = re.fullmatch(r"[\d.]+", self.item) is None
        if self.kind == "channel":
            return f"{self.group}_{self.item}" if plain else f"{self.group}_channel_{self.item}"
        return f"{self.group}_{self.item}" if plain else f"{self.group}_{self.item}_keV"


@dataclass(frozen=True, eq=False)
class Quantities:
    """Quantities of the parts of a volume, all of one group, with their truth.

    Parameters
    ----------
    each : the quantities
    truth : with the quantities in place of the basis functions, in `unit`
    energies : at which attenuation is meant [keV]; None for others
    water : attenuation of water there [1/mm]; None for others than Hounsfield units
    rows : what the basis coefficients of the dataset's truth are multiplied by; None for densities and fractions
    """

    each: tuple[Quantity, ...]
    truth: Truth
    energies: tuple[float | None, ...]
    water: tuple[float | None, ...]
    rows: Float[np.ndarray, "quantity basis"] | None = None

    @property
    def group(self) -> str:
        """Section of ``metrics.json``: ``basis``, ``attenuation``, ``density`` or ``fraction``."""
        return self.each[0].group

    @property
    def unit(self) -> str:
        """Unit of the truth."""
        return UNITS[self.group]

    def converted(self, values: np.ndarray, part: int, unit: str | None, where: str) -> Float[np.ndarray, "z y x"]:
        """Convert values of one part to the unit of the truth.

        Parameters
        ----------
        values : as in the file
        part : index of the quantity
        unit : of the values; Hounsfield units and fractions need none
        where : name of the volume, for messages

        Returns
        -------
        values in `unit`

        Raises
        ------
        InputError
            When the unit is unknown, or not one of the quantity.
        """
        water, plain = self.water[part], np.asarray(values, dtype=np.float64)
        known = _HOUNSFIELD if water is not None else _KNOWN_UNITS[self.group]
        plain_number = water is not None or self.group == "fraction"
        factor = known.get(_normal(unit)) if unit is not None else 1.0 if plain_number else None
        if factor is None:
            wanted = "HU" if water is not None else ", ".join(known)
            hint = ", or --as hu:KEV" if unit is not None and _normal(unit) in _HOUNSFIELD else ""
            raise InputError(
                f"{where}: the unit {unit!r} is not one of {self.each[part]}: state --units, one of {wanted}{hint}"
            )
        return water * (1 + plain / 1000) if water is not None else factor * plain


def parse_quantities(text: str) -> tuple[Quantity, ...]:
    """Read what volumes hold.

    Parameters
    ----------
    text : such as ``basis:photoelectric,compton``, ``mono:60``, ``channel:bin1``, ``hu:60`` ``density:iodine`` or
        ``fraction:bone``

    Returns
    -------
    the quantities in their order

    Raises
    ------
    InputError
        When the text says none.
    """
    kind, colon, items = text.strip().partition(":")
    found = [item.strip() for item in items.split(",")]
    if kind not in _GROUPS or not colon or not all(found):
        raise InputError(f"--as says what the volume holds, {KINDS}, got {text!r}")
    if kind == "mono":
        for item in found:
            _energy(item)
    return tuple(Quantity(kind, item) for item in found)


def with_truth(
    each: Sequence[Quantity], truth: Truth, spectra: Spectra, materials: Sequence[TrueMaterial]
) -> Quantities:
    """Compute the truth of quantities.

    Parameters
    ----------
    each : quantities
    truth : of a dataset
    spectra : of the dataset, in its own basis functions
    materials : of the truth, for densities and fractions

    Returns
    -------
    quantities with their truth

    Raises
    ------
    InputError
        When the dataset has no such basis function, channel or material, or quantities are of several groups.
    """
    groups = sorted({quantity.group for quantity in each})
    if len(groups) != 1:
        raise InputError(f"volumes of one score must be of one kind, got {' and '.join(groups)}: score them one by one")
    if len({quantity.label for quantity in each}) < len(each):
        raise InputError(f"each quantity is scored once, got {', '.join(map(str, each))}")
    names = tuple(quantity.label for quantity in each)
    if groups[0] in ("density", "fraction"):
        find = _densities if groups == ["density"] else _shares
        weights = np.array([find(quantity.item, materials) for quantity in each])  # quantity, material
        scaled = (weights / FRACTION_SCALE).astype(np.float32)
        volumes = np.einsum("qm,mzyx->qzyx", scaled, truth.fractions, dtype=np.float32)
        nothing = (None,) * len(each)
        true = replace(truth, basis_names=names, volumes=volumes, coefficients=weights.T)
        return Quantities(tuple(each), true, nothing, nothing)
    energies = [_energy_of(quantity, spectra) for quantity in each]
    rows = np.array([_weights(q, e, truth, spectra) for q, e in zip(each, energies, strict=True)])  # quantity, basis
    volumes = np.einsum("qb,bzyx->qzyx", rows, truth.volumes).astype(np.float32)
    true = replace(truth, basis_names=names, volumes=volumes, coefficients=truth.coefficients @ rows.T)
    water = tuple(
        _water(row, truth, spectra) if quantity.kind == "hu" else None for quantity, row in zip(each, rows, strict=True)
    )
    return Quantities(tuple(each), true, tuple(energies), water, rows)


def _energy(item: str) -> float:
    """Energy from text [keV]."""
    try:
        energy = float(item)
    except ValueError:
        energy = np.nan
    if not LOWEST_ENERGY <= energy <= HIGHEST_ENERGY:
        raise InputError(
            f"an energy must be a number of keV from {LOWEST_ENERGY:g} to {HIGHEST_ENERGY:g}, such as mono:60, "
            f"got {item!r}"
        )
    return energy


def _energy_of(quantity: Quantity, spectra: Spectra) -> float | None:
    """Energy at which attenuation is meant [keV]; that of a channel is the mean of what it counts in the open beam."""
    if quantity.kind == "basis":
        return None
    if quantity.kind == "mono" or (quantity.kind == "hu" and quantity.item not in spectra.channels):
        return _energy(quantity.item)
    known = spectra.channels
    if quantity.item in known:
        index = known.index(quantity.item)
    elif quantity.item.isdigit() and int(quantity.item) < len(known):
        index = int(quantity.item)
    else:
        counted = f"or their number from 0 to {len(known) - 1}"
        raise InputError(f"the dataset has no channel {quantity.item!r}: choose from {', '.join(known)}, {counted}")
    energy = float(spectra.effective_energy[index])
    if np.isnan(energy):
        raise InputError(f"the channel {known[index]} counts nothing, so it has no effective energy: state mono:KEV")
    return energy


def _weights(quantity: Quantity, energy: float | None, truth: Truth, spectra: Spectra) -> Float[np.ndarray, " basis"]:
    """Return the factors of the basis coefficients of the truth."""
    if energy is None:
        if quantity.item not in truth.basis_names:
            raise InputError(f"the dataset has no basis {quantity.item!r}: choose from {', '.join(truth.basis_names)}")
        return np.array([float(name == quantity.item) for name in truth.basis_names])
    rows = dict(zip(spectra.basis.names, spectra.basis.evaluate(np.array([energy]))[:, 0], strict=True))
    if not set(truth.basis_names) <= set(rows):
        raise InputError(
            f"the truth is in {', '.join(truth.basis_names)}, the spectra of the dataset in {', '.join(rows)}"
        )
    return np.array([rows[name] for name in truth.basis_names])


def _water(row: Float[np.ndarray, " basis"], truth: Truth, spectra: Spectra) -> float:
    """Attenuation of the dataset's material ``water``, or of water fitted by its basis as materials are [1/mm]."""
    if "water" in truth.material_names:
        return float(truth.coefficients[truth.material_names.index("water")] @ row)
    found = WATER.coefficients_in(spectra.basis, spectra.energy, spectra.weights.sum(axis=0))
    known = dict(zip(spectra.basis.names, found, strict=True))
    return float(np.array([known[name] for name in truth.basis_names]) @ row)


def _densities(item: str, materials: Sequence[TrueMaterial]) -> list[float]:
    """Density of a material, or of an element, in each material of the truth [g/cm^3]."""
    names = [material.name for material in materials]
    if item in names:
        density = materials[names.index(item)].density
        if density is None:
            raise InputError(f"the material {item} of the dataset is given by coefficients and has no density")
        return [density if name == item else 0.0 for name in names]
    try:
        number = atomic_number(_ELEMENTS.get(item.lower(), item))
    except InputError:
        known = ", ".join(names)
        raise InputError(
            f"the dataset has no material {item!r}: choose from {known}, or an element such as iodine or Gd"
        ) from None
    found = []
    for material in materials:
        if material.composition is None or material.density is None:
            raise InputError(
                f"the material {material.name} of the dataset is given by coefficients, so its {item} is not known"
            )
        found.append(material.density * dict(mass_fractions(material.composition)).get(number, 0.0))
    return found


def _shares(item: str, materials: Sequence[TrueMaterial]) -> list[float]:
    """Share of a material in each material of the truth: 1 in itself, 0 in others."""
    names = [material.name for material in materials]
    if item not in names:
        raise InputError(f"the dataset has no material {item!r}: choose from {', '.join(names)}")
    return [float(name == item) for name in names]


def _normal(unit: str) -> str:
    """A unit in the spelling of the tables."""
    text = re.sub(r"\s", "", unit).lower().replace("**", "^").replace("³", "^3").replace("⁻¹", "^-1")
    text = re.sub(r"^/?([cm]?m)\^?-1$", r"1/\1", text)
    text = f"1{text}" if text.startswith("/") else text
    text = re.sub(r"(cm|m)3$", r"\1^3", text).replace("g/cc", "g/cm^3")
    return {"hounsfield": "hu", "hounsfieldunits": "hu"}.get(text, text)
