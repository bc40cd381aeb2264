"""Which of a file's basis functions were asked for, by number or by name, and which are left out."""

from collections.abc import Sequence
from typing import TypeAlias

from phantomgen.dataset.reader import Dataset
from spectra.basis.basis import Basis
from spectra.errors import InputError

Asked: TypeAlias = int | Sequence[str] | None  # so many, these, or those that the data warrant


def parse_bases(text: str) -> int | tuple[str, ...] | None:
    """``auto``, a number, or names with commas between."""
    if text.strip() == "auto":
        return None
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
    """The functions of these names, in the order of the file.

    Parameters
    ----------
    stated : what the file has
    names : of the functions
    where : the file, for a message

    Raises
    ------
    InputError
        When a name is not known, or said twice, or there is none.
    """
    for name in names:
        if name not in stated.names:
            raise InputError(f"{where} has no basis {name!r}: choose from {', '.join(stated.names)}")
    if len(set(names)) < len(names) or not names:
        raise InputError(f"each basis is named once, and at least one, got {', '.join(names) or 'none'}")
    return Basis(tuple(f for f in stated.functions if f.name in names), stated.reference_energy)


def with_named(dataset: Dataset, bases: Asked) -> tuple[Dataset, int | None]:
    """The dataset in the functions that were named, and how many of its functions were asked for otherwise."""
    if bases is None or isinstance(bases, int):
        return dataset, bases
    return dataset.with_basis(named_basis(dataset.spectra.basis, bases, dataset.path)), None


def left_out(stated: Sequence[str], fitted: Sequence[str]) -> tuple[str, ...]:
    """Names that the file has and a model lacks."""
    return tuple(name for name in stated if name not in fitted)


def left_out_sentence(names: Sequence[str]) -> str:
    """That some of the file's functions are not fitted; empty without any."""
    return f"Not fitted, though the file has it: {', '.join(names)}" if names else ""
