"""Contenders of a comparison: a method and its changes, as one word.

``sart``, ``sart+image``, ``one-step+curve``, ``gaussian+best``, ``gaussian+2``, ``paper+without-tv``,
``gaussian+views-25``, ``gaussian+blind-bin1``: the method first, and after each plus sign a change. The word names the
contender in tables, options and folders.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from recon.published_methods.paper.recipe import checked
from recon.runs.methods import METHODS, NEED_CURVE, ON_CURVE
from spectra.errors import InputError

GAUSSIAN, PAPER = "gaussian", "paper"
_CHANGES = "best, plain, image, curve, 2, 3, views-N, blind-CHANNEL, without-COMPONENT"


@dataclass(frozen=True)
class Contender:
    """A method and its changes.

    Parameters
    ----------
    method : ``gaussian``, ``paper``, or a name in `recon.runs.methods.METHODS`
    best : whether the fit takes its longer recipe
    plain : whether the fit has plain Gaussians, without planes
    image : whether channels are reconstructed one by one, and decomposed in the voxels afterwards
    curve : whether coefficients lie on the standard curve of materials, as for ``--bases curve``
    bases : number of basis functions; None for all, and for ``gaussian`` for those that the counts warrant
    views : number of training views to use, evenly spread; None for all
    blind : channel that is not used; None for none
    without : components of the paper's method that are switched off
    """

    method: str
    best: bool = False
    plain: bool = False
    image: bool = False
    curve: bool = False
    bases: int | None = None
    views: int | None = None
    blind: str | None = None
    without: tuple[str, ...] = ()

    @property
    def is_fit(self) -> bool:
        """Whether it fits Gaussians by a schedule, which must know its length from the start."""
        return self.method in (GAUSSIAN, PAPER)

    @property
    def on_curve(self) -> bool:
        """Whether coefficients lie on a curve of materials, by choice or because the method needs it."""
        return self.curve or self.method in NEED_CURVE

    def __str__(self) -> str:
        parts = [
            self.method,
            "plain" if self.plain else "",
            "best" if self.best else "",
            "image" if self.image else "",
            "curve" if self.curve else "",
            str(self.bases or ""),
            f"views-{self.views}" if self.views is not None else "",
            f"blind-{self.blind}" if self.blind is not None else "",
            *(f"without-{name}" for name in self.without),
        ]
        return "+".join(part for part in parts if part)


def known_methods() -> tuple[str, ...]:
    """List the methods that can be compared.

    Returns
    -------
    their names
    """
    return (GAUSSIAN, PAPER, *METHODS)


def contender(word: str) -> Contender:
    """Read a contender from its word.

    Parameters
    ----------
    word : such as ``gaussian+2``

    Returns
    -------
    the contender

    Raises
    ------
    InputError
        When there is no such method, or it has no such change.
    """
    method, *changes = word.split("+")
    if method not in known_methods():
        raise InputError(f"there is no method {method!r} to compare: choose from {', '.join(known_methods())}")
    found: dict = {"method": method, "without": ()}
    for change in changes:
        if change == "image" and method not in (GAUSSIAN, PAPER):
            found["image"] = True
        elif change == "curve" and method in (GAUSSIAN, *ON_CURVE) and method not in NEED_CURVE:
            found["curve"] = True
        elif change in ("best", "plain") and method == GAUSSIAN:
            found[change] = True
        elif change in ("2", "3"):
            found["bases"] = int(change)
        elif re.fullmatch(r"views-[1-9]\d*", change):
            found["views"] = int(change.removeprefix("views-"))
        elif re.fullmatch(r"blind-[\w.-]+", change):
            found["blind"] = change.removeprefix("blind-")
        elif change.startswith("without-") and method == PAPER:
            found["without"] += checked([change.removeprefix("without-")])
        else:
            raise InputError(f"{word}: {change!r} is no change of the method {method}: choose from {_CHANGES}")
    if found.get("image") and "blind" in found:
        raise InputError(f"{word}: a method that takes every channel by itself cannot predict one that it has not seen")
    return Contender(**found)


def contenders(words: Iterable[str]) -> tuple[Contender, ...]:
    """Read contenders from their words, each once, in their order.

    Parameters
    ----------
    words : such as ``gaussian+2``

    Returns
    -------
    the contenders

    Raises
    ------
    InputError
        When there are none, or a word means nothing.
    """
    found = tuple(dict.fromkeys(contender(word.strip()) for word in words if word.strip()))
    if not found:
        raise InputError(f"a comparison needs methods: choose from {', '.join(known_methods())}")
    return found
