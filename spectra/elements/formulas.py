"""Chemical formulas that a parser would take for something else than their author meant."""

import re

from spectra.errors import InputError, shortened

_DIGITS = 6  # of a number of atoms; large proteins have some 10000 of a kind
_HINT = "give mass fractions instead, such as {'H': 0.112, 'O': 0.888}"
# Symbols of two letters; in capitals they may be read as two elements. Those of common compounds, such as the CO of
# CO2 or the HF of C2HF5, only count where the formula has no number at all.
_TWO_LETTERS = frozenset({"Bi", "Cu", "In", "Nb", "Ni", "Pb", "Pu", "Sc", "Si", "Sn", "Yb"})
_TWO_LETTERS_ALONE = _TWO_LETTERS | {"Cf", "Co", "Cs", "Hf", "Ho", "Np", "Os", "Po"}


def refuse_misread(formula: str) -> None:
    """Refuse formulas that parse but do not mean what they seem to say.

    Parameters
    ----------
    formula : chemical formula, without blanks around it

    Raises
    ------
    InputError
        Dopants such as ``CsI(Tl)``, which would mean one atom each; hydrates such as ``CaSO4.2H2O``, which would mean
        5.2 atoms of oxygen; mass fractions written as subscripts; capitals such as ``CO`` for cobalt.
    """
    if not formula.isascii():
        raise InputError(f"the formula {formula!r} holds a character that is not plain ASCII: write H2O, not H₂O")
    if re.search(r"\)(?![\d])", formula):
        raise InputError(
            f"the bracket in {formula!r} has no number behind it, which would mean one whole unit: {_HINT}"
        )
    if re.search(r"[1-9]\d*\.\d", formula):
        raise InputError(f"the decimal point in {formula!r} reads like a hydrate: {_HINT}")
    for number in re.findall(r"\d+", formula):
        if len(number) > _DIGITS:
            raise InputError(f"the formula {shortened(formula)!r} has {shortened(number)} atoms of one kind: {_HINT}")
    _refuse_fractions(formula)
    _refuse_capitals(formula)


def _refuse_fractions(formula: str) -> None:
    """Refuse numbers behind every symbol that sum to one."""
    subscripts = [float(number) for number in re.findall(r"\d*\.?\d+", formula)]
    symbols = len(re.findall(r"[A-Z][a-z]?", formula))
    if "." in formula and len(subscripts) == symbols and abs(sum(subscripts) - 1) < 1e-2:
        raise InputError(f"the numbers in {formula!r} would be taken as atoms, not as mass fractions: {_HINT}")


def _refuse_capitals(formula: str) -> None:
    """Refuse two capitals that are an element of their own, such as CO, SN or the SI of SIO2."""
    if formula != formula.upper():
        return
    meant = _TWO_LETTERS if re.search(r"\d", formula) else _TWO_LETTERS_ALONE
    for first, second in re.findall(r"(?=([A-Z])([A-Z]))", formula):
        element = first + second.lower()
        if element in meant:
            compound = formula.replace(first + second, f"{first}1{second}", 1)
            compound += "" if compound[-1].isdigit() else "1"
            raise InputError(
                f"{first + second} in {formula!r} may mean {element} or {first} and {second}: write "
                f"{formula.replace(first + second, element, 1)!r} or {compound!r}"
            )
