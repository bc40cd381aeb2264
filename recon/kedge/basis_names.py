"""Basis functions of a dataset that a user asks for, by number or by name, and those that are left out."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

from phantomgen.dataset.reader import Dataset
from recon.readouts.spectrum import detected_spectrum
from spectra.basis.basis import Basis, BasisFunction
from spectra.elements.attenuation import edge_energy, mass_fractions, symbol
from spectra.errors import InputError
from spectra.materials.material import SAME_EDGE, Material
from spectra.materials.material_curve import MaterialCurve

CURVE = "curve"  # word of ``--bases`` for `OnCurve`


@dataclass(frozen=True)
class OnCurve:
    """Bases whose coefficients lie on a curve of materials (`spectra.materials.material_curve`).

    Parameters
    ----------
    materials : named materials, formulas or NIST compounds, in any order
    """

    materials: tuple[str, ...] = ("adipose", "water", "cortical bone", "Ti", "Fe")

    def curve(self, dataset: Dataset) -> MaterialCurve:
        """Compute the curve in the bases of a dataset, over its detected spectrum.

        Parameters
        ----------
        dataset : open dataset, of which counts are not read

        Returns
        -------
        the curve
        """
        spectra, energies = dataset.spectra, detected_spectrum(dataset.spectra.basis, dataset.spectra.transmission())
        materials = [Material(name, composition=name) for name in self.materials]
        return MaterialCurve.of(materials, spectra.basis, *energies)

    def edges(self, stated: Basis, low: float, high: float) -> tuple[BasisFunction, ...]:
        """Collect the functions that the K edges of the materials take.

        Parameters
        ----------
        stated : basis of the dataset, whose functions are taken where they have the same edge
        low, high : limits of the detected energies [keV]

        Returns
        -------
        one function per edge within the limits, by energy
        """
        elements = {symbol(number) for material in self.materials for number, _ in mass_fractions(material)}
        fitting = {}
        for edge, element in sorted((edge_energy(element), element) for element in elements):
            if low < edge < high:
                near = [f for f in stated.functions if f.edge_energy and abs(f.edge_energy - edge) < SAME_EDGE]
                function = near[0] if near else BasisFunction("element", element=element)
                fitting[function.name] = function
        return tuple(fitting.values())


Asked: TypeAlias = int | Sequence[str] | OnCurve | None  # number, names, curve, or None: those that the data warrant


def parse_bases(text: str) -> int | tuple[str, ...] | OnCurve | None:
    """Read the value of ``--bases``.

    Parameters
    ----------
    text : ``auto``, a number, names with commas between, or ``curve``, also with materials: ``curve:water,Ti``

    Returns
    -------
    None for ``auto``, the number, the names, or the materials of the curve

    Raises
    ------
    InputError
        When the text is none of these.
    """
    if text.strip() == "auto":
        return None
    word, colon, materials = text.strip().partition(":")
    if word == CURVE:
        names = tuple(part.strip() for part in materials.split(","))
        if colon and not all(names):
            raise InputError(
                f"--bases curve: takes materials with commas between, such as curve:water,Ti, got {text!r}"
            )
        return OnCurve(names) if colon else OnCurve()
    try:
        count = int(text)
    except ValueError:
        names = tuple(part.strip() for part in text.split(","))
        if not all(names):
            raise InputError(
                f"--bases takes auto, a number from 2, or names such as photoelectric,compton,kedge_I, got {text!r}"
            ) from None
        return names
    if count < 2:
        raise InputError(f"--bases takes auto, a number from 2, or names of bases, got {text!r}")
    return count


def named_basis(stated: Basis, names: Sequence[str], where: object) -> Basis:
    """Select functions by their names, in the order of the file.

    Parameters
    ----------
    stated : basis of the file
    names : names of the functions
    where : name of the file, for an error

    Returns
    -------
    the basis of these functions

    Raises
    ------
    InputError
        When a name is unknown or given twice, or there is none.
    """
    for name in names:
        if name not in stated.names:
            raise InputError(f"{where} has no basis {name!r}: choose from {', '.join(stated.names)}")
    if len(set(names)) < len(names) or not names:
        raise InputError(f"each basis is named once, and at least one, got {', '.join(names) or 'none'}")
    return Basis(tuple(f for f in stated.functions if f.name in names), stated.reference_energy)


def with_named(dataset: Dataset, bases: Asked) -> tuple[Dataset, int | None]:
    """Reduce a dataset to the functions that were named.

    Parameters
    ----------
    dataset : an open dataset
    bases : number or names of functions, or a curve, which takes those without a K edge and those for the K edges of
        its materials

    Returns
    -------
    the dataset with the named functions, or as it is; the number of functions where a number was asked for
    """
    if bases is None or isinstance(bases, int):
        return dataset, bases
    if isinstance(bases, OnCurve):
        stated = dataset.spectra.basis
        smooth = tuple(f for f in stated.functions if f.edge_energy is None)
        if len(smooth) < 2:
            raise InputError(
                f"{dataset.path} has the bases {', '.join(stated.names)}: a curve needs two without a K edge"
            )
        edges = bases.edges(stated, *dataset.spectra.edges[[0, -1]])
        return dataset.with_basis(Basis((*smooth, *edges), stated.reference_energy)), None
    return dataset.with_basis(named_basis(dataset.spectra.basis, bases, dataset.path)), None


def bases_text(asked: int | Sequence[str] | OnCurve) -> str:
    """Write bases as ``--bases`` takes them.

    Parameters
    ----------
    asked : number, names, or curve

    Returns
    -------
    the value of the option
    """
    if isinstance(asked, OnCurve):
        return f"{CURVE}:{','.join(asked.materials)}"
    return str(asked) if isinstance(asked, int) else ",".join(asked)


def left_out(stated: Sequence[str], fitted: Sequence[str]) -> tuple[str, ...]:
    """List the names that the file has and a model lacks.

    Parameters
    ----------
    stated : names of the functions of the file
    fitted : names of the functions of the model

    Returns
    -------
    names of the others
    """
    return tuple(name for name in stated if name not in fitted)


def left_out_sentence(names: Sequence[str]) -> str:
    """Say which functions of the file are not fitted.

    Parameters
    ----------
    names : names of these functions

    Returns
    -------
    a sentence for a user; empty without names
    """
    return f"Not fitted, though the file has it: {', '.join(names)}" if names else ""
