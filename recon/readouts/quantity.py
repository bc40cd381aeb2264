"""Quantities by name: what `recon volume --as` writes and `recon.readout` returns."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from recon.readouts.fractions import Decomposition
from recon.readouts.readouts import Coefficients, Readouts, Volume, check_energies, tabulated_water
from spectra.elements.attenuation import symbol
from spectra.elements.named_materials import element_number
from spectra.errors import InputError
from spectra.materials.material import Material

ENERGY = 70.0  # keV; of images at one energy where none is stated; reference energy of the bases
WATERS = ("basis", "table")
CT_NUMBERS = ("hu", "vnc")
WITH_ENERGY = ("vmi", *CT_NUMBERS)
NAMES = (*WITH_ENERGY, "electron-density", "zeff")
FRACTIONS = "fractions"  # the quantity that asks for materials


@dataclass(frozen=True, eq=False)
class Quantity:
    """A physical quantity, or several in maps of their own, that follow from coefficients voxel by voxel.

    Parameters
    ----------
    name : of the volume in files
    unit : of its values
    about : what it is, in a few words
    values : function from coefficients [1/mm], (basis, ...), to the quantity, (...), or to its maps, (map, ...)
    caution : sentence on what the values cannot be relied on for; None where there is nothing to say
    parts : names of the maps; empty for a quantity of one map
    """

    name: str
    unit: str
    about: str
    values: Callable[[Coefficients], Volume]
    caution: str | None = None
    parts: tuple[str, ...] = ()

    @property
    def maps(self) -> tuple[str, ...]:
        """Names of the maps: those of the parts, or that of the quantity."""
        return self.parts or (self.name,)


def quantity(
    readouts: Readouts,
    name: str,
    energy: float | None = None,
    water: str | float | None = None,
    materials: Sequence[Material] = (),
) -> Quantity:
    """Return the quantity of a name.

    Parameters
    ----------
    readouts : conversion for the basis and the spectrum of the scan
    name : ``vmi`` (attenuation), ``hu`` (CT numbers), ``vnc`` (CT numbers without contrast agents),
        ``electron-density``, ``zeff``, ``fractions``, or an element such as ``iodine`` or ``I``, for its
        concentration
    energy : energy of ``vmi``, ``hu`` and ``vnc`` [keV]; 70 where it is None
    water : what 0 HU is: ``basis`` (the default), water as the basis describes it; ``table``, water at 1 g/cm^3; or
        its attenuation at the energy [1/mm]
    materials : of ``fractions``, which are volume fractions (`recon.readouts.fractions`)

    Returns
    -------
    the quantity

    Raises
    ------
    InputError
        When there is no such quantity, or the basis cannot show it, or an energy or water is not possible.
    """
    if materials and name != FRACTIONS:
        raise InputError(f"--material is for --as {FRACTIONS}, not for {name}")
    if name in WITH_ENERGY:
        (at,) = check_energies((ENERGY if energy is None else energy,))
        return _at_energy(readouts, name, at, water)
    if energy is not None:
        raise InputError(f"--energy is for images at one energy ({', '.join(WITH_ENERGY)}), not for {name}")
    if water is not None:
        raise InputError(f"--water is for CT numbers (hu, vnc), not for {name}")
    if name == FRACTIONS:
        return _fractions(readouts, materials)
    if name in ("electron-density", "zeff"):
        if not readouts.tells_electrons:
            raise InputError(
                f"{name} needs two basis functions besides those of contrast agents, but the basis is "
                f"{', '.join(readouts.basis.names)}"
            )
        if name == "zeff":
            about = "effective atomic number without contrast agents, NaN in air"
            return Quantity("effective_atomic_number", "1", about, readouts.effective_atomic_number)
        about = "electron density over that of water, without contrast agents"
        return Quantity("electron_density", "1", about, readouts.electron_density)
    element = _element_of(name)
    readouts.concentration(readouts.water, element)
    return Quantity(
        f"concentration_{element}",
        "mg/ml",
        f"concentration of {element}",
        lambda values: readouts.concentration(values, element),
    )


def _fractions(readouts: Readouts, materials: Sequence[Material]) -> Quantity:
    """Volume fractions, a map per material."""
    if not materials:
        raise InputError(
            f"--as {FRACTIONS} needs the materials: add --material for each, such as --material water --material Al"
        )
    found = Decomposition.of(materials, readouts.basis, *readouts.spectrum)
    about = f"volume fractions of {', '.join(found.names)}"
    return Quantity(FRACTIONS, "1", about, found.fractions, parts=found.names)


def _at_energy(readouts: Readouts, name: str, energy: float, water: str | float | None) -> Quantity:
    """Image at one energy."""
    caution = readouts.extrapolation(energy)
    if name == "vmi":
        if water is not None:
            raise InputError("--water is for CT numbers (hu, vnc), not for vmi")
        about = f"attenuation at {energy:g} keV"
        return Quantity(
            f"attenuation_{energy:g}_keV", "1/mm", about, lambda values: readouts.attenuation(values, energy), caution
        )
    zero = attenuation_of_water(energy, water)
    if name == "hu":
        about = f"CT numbers at {energy:g} keV"
        return Quantity(
            f"hounsfield_{energy:g}_keV", "HU", about, lambda values: readouts.hounsfield(values, energy, zero), caution
        )
    if not (readouts.agents or readouts.nameless):
        raise InputError(
            f"a virtual non-contrast image needs a basis function of a contrast agent, but the basis is "
            f"{', '.join(readouts.basis.names)}"
        )
    about = f"CT numbers at {energy:g} keV without contrast agents"
    return Quantity(
        f"virtual_non_contrast_{energy:g}_keV",
        "HU",
        about,
        lambda values: readouts.virtual_non_contrast(values, energy, zero),
        caution,
    )


def attenuation_of_water(energy: float, water: str | float | None) -> float | None:
    """Return the attenuation that is 0 HU.

    Parameters
    ----------
    energy : energy [keV]
    water : as in `quantity`

    Returns
    -------
    attenuation [1/mm]; None for that of water as the basis describes it

    Raises
    ------
    InputError
        When it is neither a known word nor a positive number.
    """
    if water is None or water == "basis":
        return None
    if water == "table":
        return tabulated_water(energy)
    try:
        number = float(water)
    except ValueError:
        number = np.nan
    if not 0 < number < np.inf:
        raise InputError(
            f"--water must be one of {', '.join(WATERS)}, or the attenuation of water at {energy:g} keV in 1/mm, such "
            f"as {tabulated_water(energy):.5f}, got {water!r}"
        )
    return number


def in_pieces(
    chosen: Quantity, values: Float[np.ndarray, "basis z y x"], voxels: int = 1 << 20
) -> Float[np.ndarray, "*map z y x"]:
    """Compute a quantity of volumes layer by layer, so that no intermediate result is as large as the volumes.

    Parameters
    ----------
    chosen : the quantity
    values : coefficients [1/mm]
    voxels : about how many are computed at once

    Returns
    -------
    the quantity in float32, (z, y, x); of several maps (map, z, y, x)
    """
    step = max(1, voxels // max(1, int(np.prod(values.shape[2:]))))
    maps = (len(chosen.parts),) if chosen.parts else ()
    found = np.empty((*maps, *values.shape[1:]), np.float32)
    for first in range(0, values.shape[1], step):
        found[..., first : first + step, :, :] = chosen.values(values[:, first : first + step])
    return found


def _element_of(name: str) -> str:
    """Symbol of an element of which there is a name or a symbol."""
    number = element_number(name)
    if number is not None:
        return symbol(number)
    if name.isalpha() and len(name) <= 2:
        return name.capitalize()
    raise InputError(
        f"there is no quantity {name!r}: choose from {', '.join((*NAMES, FRACTIONS))}, or name an element, such as "
        "iodine or Gd"
    )
