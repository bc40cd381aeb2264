"""Spectra from text files of two columns: energies [keV] and photons."""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float

from spectra.errors import InputError

Column = Float[np.ndarray, " row"]
# Energies of a table are written with few digits: steps that agree to this part of a step are equal.
_ROUNDING = 0.01


def read_spectrum(
    path: Path, values: str, energies: str
) -> tuple[Float[np.ndarray, " energy_plus_1"], Float[np.ndarray, " energy"]]:
    """Bin edges [keV] and photons per bin.

    Parameters
    ----------
    path : text file; columns are separated by commas, semicolons or blanks, and comments start with #
    values : the second column is photons ``per_bin``, or a density ``per_kev`` that is constant over each bin
    energies : the first column is bin ``centres``, evenly spaced; or bin ``edges``, then a value belongs to the bin
        that begins there, and the last row only ends the last bin, with value 0
    """
    lines, energy, value = _columns(path)
    for i in np.flatnonzero(np.diff(energy) <= 0):
        raise InputError(
            f"{path}:{lines[i + 1]}: energies must ascend, but {energy[i + 1]:g} keV follows {energy[i]:g} keV"
        )
    if energies == "edges":
        if value[-1] != 0:
            raise InputError(
                f"{path}:{lines[-1]}: the last of the edges only ends the last bin, so its value must be 0, "
                f"got {value[-1]:g}; or do the energies mean centres?"
            )
        edges, value = energy, value[:-1]
    else:
        edges = _edges_around(path, lines, energy)
    photons = value * np.diff(edges) if values == "per_kev" else value
    if not photons.any():
        raise InputError(f"{path} holds no photons: all values are 0")
    return edges, photons


def _columns(path: Path) -> tuple[list[int], Column, Column]:
    """Line numbers and the two columns."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path} cannot be read as a spectrum: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} cannot be read as a spectrum: it is not UTF-8 text") from None
    rows = [(number, line.partition("#")[0].strip()) for number, line in enumerate(text.splitlines(), 1)]
    table = [(number, *_row(f"{path}:{number}", line)) for number, line in rows if line]
    if len(table) < 2:
        raise InputError(f"{path}: a spectrum needs at least two rows of energy and photons, got {len(table)}")
    lines, energy, value = zip(*table, strict=True)
    return list(lines), np.array(energy), np.array(value)


def _row(place: str, line: str) -> tuple[float, float]:
    """Energy and value of one line."""
    cells = re.split(r"\s*[,;]\s*|\s+", line)
    if len(cells) != 2:
        raise InputError(f"{place}: a row has two columns, energy [keV] and photons, got {len(cells)}")
    try:
        energy, value = map(float, cells)
    except ValueError:
        raise InputError(f"{place}: {line!r} is not two numbers; a header starts with #") from None
    if not (np.isfinite(energy) and np.isfinite(value)):
        raise InputError(f"{place}: a number must be finite, got {line!r}")
    if not 0 <= energy <= 800:
        raise InputError(f"{place}: energies must lie within 0 .. 800 keV, got {energy:g}; are they in another unit?")
    if value < 0:
        raise InputError(f"{place}: photons must not be negative, got {value:g}")
    return energy, value


def _edges_around(path: Path, lines: list[int], centres: Column) -> Float[np.ndarray, " energy_plus_1"]:
    """Edges of equal bins around their centres."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    even = centres[0] + step * np.arange(len(centres))
    for i in np.flatnonzero(np.abs(centres - even) > _ROUNDING * step):
        raise InputError(
            f"{path}:{lines[i]}: centres must be evenly spaced, here by {step:g} keV, but {centres[i]:g} stands where "
            f"{even[i]:g} would; give edges instead"
        )
    return np.maximum(centres[0] + step * (np.arange(len(centres) + 1) - 0.5), 0.0)
