"""Known materials, and the data of one: density, elements, attenuation, and its fit in the basis."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.scene.file.find_scene import find_scene
from phantomgen.scene.file.scene_file import closest
from phantomgen.scene.materials import scene_materials
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import k_edges, mass_fractions, natural_density, nist_names, symbol
from spectra.elements.named_materials import ELEMENTS, GROUPS, LIBRARY
from spectra.errors import InputError
from spectra.materials.material import Material

LOWEST, HIGHEST, STEP = 20.0, 140.0, 0.25  # keV, the range of the fit
# Energies of the printed table [keV].
_PRINTED = (20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 100.0, 120.0, 140.0)

EnergyArray = Float[np.ndarray, " energy"]


@dataclass(frozen=True, eq=False)
class MaterialFit:
    """Fit of a composition: photoelectric, Compton and one element function per K edge from 20 to 140 keV.

    Parameters
    ----------
    material : what is described
    basis : the functions
    coefficients : found by relative least squares, every 0.25 keV weighs the same [1/mm]
    energy : where mu is known [keV]
    exact, fitted : mu from tables, and of the coefficients [1/mm]
    """

    material: Material
    basis: Basis
    coefficients: Float[np.ndarray, " basis"]
    energy: EnergyArray
    exact: EnergyArray
    fitted: EnergyArray

    @classmethod
    def of(cls, material: Material) -> "MaterialFit":
        """Fit a material.

        Parameters
        ----------
        material : with a composition

        Returns
        -------
        the fit

        Raises
        ------
        InputError
            When the material has no composition.
        """
        if material.composition is None:
            raise InputError(f"material {material.name!r} is given by coefficients: there is no curve to compare with")
        basis = _basis(material)
        energy = np.arange(LOWEST, HIGHEST + STEP / 2, STEP)
        coefficients = material.coefficients_in(basis, energy, np.ones_like(energy))
        fitted = coefficients @ basis.evaluate(energy)
        return cls(material, basis, coefficients, energy, material.attenuation(energy), fitted)

    @property
    def errors(self) -> EnergyArray:
        """Relative error of the fitted mu(E) [no unit]."""
        return self.fitted / self.exact - 1

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        printed = np.array(_PRINTED)
        mu = self.material.attenuation(printed)
        elements = {symbol(number): share for number, share in mass_fractions(self.material.composition or {})}
        name = self.material.composition if isinstance(self.material.composition, str) else ""
        return {
            "name": self.material.name,
            "density": self.material.density,
            "source": LIBRARY[name].source if name in LIBRARY else "",
            "mass_fractions": elements,
            "k_edges_keV": dict(zip(self._edge_elements, self.basis.breaks, strict=True)),
            "energy_keV": list(_PRINTED),
            "mu_per_mm": mu.tolist(),
            "mu_rho_cm2_per_g": (10 * mu / float(self.material.density or 1.0)).tolist(),
            "fit_range_keV": [LOWEST, HIGHEST],
            "coefficients_per_mm": dict(zip(self.basis.names, self.coefficients.tolist(), strict=True)),
            "fit_rms": float(np.sqrt(np.mean(self.errors**2))),
            "fit_worst": float(np.abs(self.errors).max()),
        }

    @property
    def text(self) -> str:
        """Fit as text."""
        facts = self.to_dict()
        source = f", {facts['source']}" if facts["source"] else ""
        fractions = ", ".join(f"{element} {share:.4g}" for element, share in facts["mass_fractions"].items())
        edges = ", ".join(f"{element} {edge:.3f} keV" for element, edge in facts["k_edges_keV"].items())
        rows = zip(facts["energy_keV"], facts["mu_per_mm"], facts["mu_rho_cm2_per_g"], strict=True)
        lines = [
            f"{facts['name']}: {facts['density']:g} g/cm^3{source}",
            f"mass fractions  {fractions}",
            *([f"K edges         {edges}"] if edges else []),
            "",
            "E [keV]   mu [1/mm]   mu/rho [cm^2/g]",
            *(f"{energy:7g}   {mu:9.4g}   {per_mass:15.4g}" for energy, mu, per_mass in rows),
            "",
            f"coefficients [1/mm], relative least squares over {LOWEST:g}..{HIGHEST:g} keV",
            *(f"  {name:<14}{value:.5g}" for name, value in facts["coefficients_per_mm"].items()),
            f"error of the fit to mu(E): rms {facts['fit_rms']:.2%}, worst {facts['fit_worst']:.2%}",
        ]
        return "\n".join(lines)

    @property
    def _edge_elements(self) -> list[str]:
        """Elements of the element functions, by the energy of their edge."""
        functions = [f for f in self.basis.functions if f.edge_energy is not None]
        return [str(f.element) for f in sorted(functions, key=lambda f: float(f.edge_energy or 0.0))]


def catalogue() -> dict[str, dict[str, float]]:
    """Return the densities of known materials, in groups: library, elements, NIST compounds.

    Returns
    -------
    density [g/cm^3] by group and name
    """
    library = {group: {name: entry.density for name, entry in entries.items()} for group, entries in GROUPS.items()}
    elements = {symbol(number): float(natural_density(symbol(number)) or 0) for number in range(1, len(ELEMENTS) + 1)}
    nist = {name: float(natural_density(name) or 0) for name in sorted(nist_names(), key=str.casefold)}
    return {**library, "elements": elements, "NIST compounds": nist}


def catalogue_text(groups: dict[str, dict[str, float]]) -> str:
    """Return the catalogue as text.

    Parameters
    ----------
    groups : result of `catalogue`

    Returns
    -------
    lines of text
    """
    called = {symbol(i + 1): name for i, name in enumerate(ELEMENTS)}
    lines = []
    for group, densities in groups.items():
        lines += ["", f"{group} [g/cm^3]"] if lines else [f"{group} [g/cm^3]"]
        for name, density in densities.items():
            shown = f"{name:<4}{called[name]}" if group == "elements" else name
            lines.append(f"  {density:<11.6g}{shown}")
    return "\n".join(lines)


def find_material(name: str, density: float | None = None, scene: str | None = None) -> Material:
    """Return a material by name or formula, or one of a scene.

    Parameters
    ----------
    name : of the catalogue, a formula, or a name in `scene`
    density : [g/cm^3]; needed for formulas
    scene : preset or scene file whose materials are meant

    Returns
    -------
    the material

    Raises
    ------
    InputError
        When the name is unknown.
    """
    if scene is None:
        return Material(name, density, name)
    file = find_scene(scene)
    materials = scene_materials(file)
    if name not in materials:
        raise InputError(f"{file.name} has no material {name!r}{closest(name, materials)}")
    return materials[name]


def _basis(material: Material) -> Basis:
    """Photoelectric, Compton, and the elements that have their K edge in the range."""
    elements = [symbol(number) for number, _ in mass_fractions(material.composition or {})]
    edged = [element for element in elements if k_edges(element, LOWEST, HIGHEST)]
    functions = (BasisFunction("element", element=element) for element in edged)
    return Basis((BasisFunction("photoelectric"), BasisFunction("compton"), *functions))
