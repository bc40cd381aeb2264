"""Materials made of materials: mixtures by mass or by volume, and solutions.

Volumes are taken as additive: every part keeps the volume that its mass fills at its own density. Then attenuation
mixes by volume, mu = sum_i phi_i mu_i, and a mixture by mass has the density 1 / sum_i (w_i / rho_i). Real liquids
contract by up to 4 % (ethanol in water), and dissolved salts displace less than their crystals would; whoever has
measured the density gives it.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from spectra.elements.attenuation import Composition, mass_fractions, natural_density, symbol
from spectra.errors import InputError
from spectra.materials.material import Material

# Fractions must sum to 1 within this, no unit: rounding of numbers that are typed.
_SUM_TOLERANCE = 1e-3
_MG_PER_ML = 1e-3  # in g/cm^3


@dataclass(frozen=True)
class Part:
    """Part of a mixture: a material and its amount.

    Parameters
    ----------
    name : for messages
    amount : fraction of the mass or the volume [no unit], or concentration [mg/ml]
    composition : formula, name or mass fractions
    density : of the part alone [g/cm^3]; None where it is not known
    """

    name: str
    amount: float
    composition: Composition
    density: float | None = None

    @classmethod
    def of(cls, material: Material | str, amount: float) -> "Part":
        """Create a part from a material, or from a formula or name whose density may be unknown.

        Parameters
        ----------
        material : material, formula or name
        amount : fraction of the mass or the volume [no unit], or concentration [mg/ml]

        Returns
        -------
        the part

        Raises
        ------
        InputError
            When the material is given by coefficients.
        """
        if isinstance(material, str):
            return cls(material, amount, material, natural_density(material))
        if material.composition is None:
            raise InputError(f"{material.name!r} is given by coefficients: only compositions can be mixed")
        return cls(material.name, amount, material.composition, material.density)

    @property
    def known_density(self) -> float:
        """The density [g/cm^3], or an error where it is not known."""
        if self.density is None:
            raise InputError(f"{self.name!r} needs a density to be mixed: make it a material with one")
        return self.density


def mix_by_mass(name: str, parts: Sequence[Part], density: float | None = None) -> Material:
    """Compute a mixture by mass fractions.

    Parameters
    ----------
    name : of the mixture
    parts : with mass fractions that sum to 1 within 1e-3
    density : measured one [g/cm^3]; that of additive volumes where left out

    Returns
    -------
    the mixture
    """
    shares = _shares(name, parts, "mass")
    if density is None:
        density = 1.0 / sum(share / part.known_density for share, part in zip(shares, parts, strict=True))
    return _mixed(name, zip(shares, parts, strict=True), density)


def mix_by_volume(name: str, parts: Sequence[Part], density: float | None = None) -> Material:
    """Compute a mixture by volume fractions.

    Parameters
    ----------
    name : of the mixture
    parts : with volume fractions, before mixing, that sum to 1 within 1e-3
    density : measured one [g/cm^3]; that of additive volumes where left out

    Returns
    -------
    the mixture
    """
    shares = _shares(name, parts, "volume")
    masses = [share * part.known_density for share, part in zip(shares, parts, strict=True)]
    total = sum(masses)
    weighed = [(mass / total, part) for mass, part in zip(masses, parts, strict=True)]
    return _mixed(name, weighed, total if density is None else density)


def dissolve(name: str, solvent: Part, solutes: Sequence[Part], density: float | None = None) -> Material:
    """Compute a solution or suspension.

    Parameters
    ----------
    name : of the solution
    solvent : its amount is not used
    solutes : with their mass per volume of the finished solution [mg/ml]
    density : measured one [g/cm^3], see below

    Returns
    -------
    the solution

    Raises
    ------
    InputError
        When the solutes fill more than the volume, or weigh more than the density allows.

    Notes
    -----
    Solutes displace solvent, volume-additively: one millilitre of solution holds the mass c_i of each solute, which
    fills c_i / rho_i at the density rho_i of the pure solute, and solvent fills the rest, so
    rho = sum_i c_i + (1 - sum_i c_i / rho_i) rho_solvent. The solutes' attenuation is exact in any case; what the rule
    can get wrong is the amount of solvent, of which 10 mg/ml of iodine displace 0.2 %. With a measured density the
    solvent is the rest of the mass, rho - sum_i c_i, and no density of a solute is needed.
    """
    masses = [_MG_PER_ML * solute.amount for solute in solutes]
    if not all(0 <= mass < float("inf") for mass in masses):
        raise InputError(f"concentrations of {name!r} must be finite and not negative [mg/ml]")
    if density is None:
        filled = sum(m / solute.known_density for m, solute in zip(masses, solutes, strict=True) if m > 0)
        if filled > 1:
            raise InputError(
                f"the solutes of {name!r} would fill {filled:.3g} times its volume at their own densities: give the "
                "density of the solution, or less of them"
            )
        rest = (1 - filled) * solvent.known_density
        density = sum(masses) + rest
    else:
        rest = density - sum(masses)
        if rest < 0:
            raise InputError(f"the solutes of {name!r} weigh more than its density of {density:g} g/cm^3 allows")
    weighed = [(mass / density, solute) for mass, solute in zip(masses, solutes, strict=True)]
    return _mixed(name, [(rest / density, solvent), *weighed], density)


def _shares(name: str, parts: Sequence[Part], by: str) -> list[float]:
    """Fractions that sum to exactly one."""
    amounts = [part.amount for part in parts]
    if not amounts or not all(0 <= amount <= 1 for amount in amounts):
        raise InputError(f"the {by} fractions of {name!r} must lie between 0 and 1, got {amounts}")
    total = sum(amounts)
    if abs(total - 1) > _SUM_TOLERANCE:
        raise InputError(f"the {by} fractions of {name!r} must sum to 1, they sum to {total:g}")
    return [amount / total for amount in amounts]


def _mixed(name: str, parts: Iterable[tuple[float, Part]], density: float) -> Material:
    """Elements of all parts, weighed by the parts' mass fractions."""
    elements: dict[str, float] = {}
    for share, part in parts:
        for number, fraction in mass_fractions(part.composition):
            elements[symbol(number)] = elements.get(symbol(number), 0.0) + share * fraction
    return Material(name, density, {element: fraction for element, fraction in elements.items() if fraction > 0})
