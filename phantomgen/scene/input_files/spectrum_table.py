"""Spectra in text files of two columns, energies [keV] and photons: those of others, and our own, which lose nothing.

Bins lose where photons lie in them: a line counts as if it were spread over its bin. So `write_source` writes what a
source consists of: corners of its density, and lines and edges with a word in a third column.
"""

import re
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int64, Shaped

from spectra.errors import InputError
from spectra.source.source import Source

Column = Float[np.ndarray, " row"]
# Energies of a table are written with few digits: steps that agree to this part of a step are equal.
_ROUNDING = 0.01
LINE, EDGE = "line", "edge"


def write_source(source: Source, path: Path, title: str) -> None:
    """Write a source to a text file with all digits; `read_source` reads the same source back.

    Parameters
    ----------
    source : the source
    path : the file
    title : first line of the comment

    Raises
    ------
    InputError
        Where the file cannot be written.
    """
    corners = [
        f"{float(e)!r}, {float(d)!r}" + (f", {EDGE}" if e in source.breaks else "")
        for e, d in zip(source.energy, source.density, strict=True)
    ]
    lines = [
        f"{float(e)!r}, {float(n)!r}, {LINE}" for e, n in zip(source.line_energy, source.line_photons, strict=True)
    ]
    head = [
        f"# {title}: {source.photons:.10g} photons per pixel and view at the panel centre",
        "# source: {type: table, file: ..., values: per_kev, energies: corners}",
        f"# energy [keV], photons per keV, linear between rows; with '{LINE}', photons of a single energy",
    ]
    try:
        path.write_text("\n".join([*head, *corners, *lines, ""]), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from None


def read_source(path: Path, values: str, energies: str) -> Source:
    """Read the source that a table describes.

    Parameters
    ----------
    path, values, energies : as in `read_spectrum`, or `energies` are ``corners`` as `write_source` has them

    Returns
    -------
    the source

    Raises
    ------
    InputError
        When the file is missing or is no such table.
    """
    if energies != "corners":
        return Source.of_bins(*read_spectrum(path, values, energies))
    if values != "per_kev":
        raise InputError(f"{path}: between corners, values are a density, so that they must be per_kev, got {values}")
    lines, energy, value, word = _columns(path, (LINE, EDGE))
    single = word == LINE
    _refuse_descent(path, lines[~single], energy[~single], 0)
    try:
        return Source.of_corners(
            energy[~single],
            value[~single],
            dict(zip(energy[single].tolist(), value[single].tolist(), strict=True)),
            tuple(np.unique(energy[word == EDGE]).tolist()),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def read_spectrum(
    path: Path, values: str, energies: str
) -> tuple[Float[np.ndarray, " energy_plus_1"], Float[np.ndarray, " energy"]]:
    """Read bin edges [keV] and photons per bin.

    Parameters
    ----------
    path : text file; columns are separated by commas, semicolons or blanks, and comments start with #
    values : the second column is photons ``per_bin``, or a density ``per_kev`` that is constant over each bin
    energies : the first column is bin ``centres``, evenly spaced; or bin ``edges``, then a value belongs to the bin
        that begins there, and the last row only ends the last bin, with value 0

    Returns
    -------
    edges [keV], one more than bins, and photons per bin

    Raises
    ------
    InputError
        When the file is missing or is no such table.
    """
    lines, energy, value, _ = _columns(path)
    _refuse_descent(path, lines, energy, np.nextafter(0, 1))
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


def _refuse_descent(path: Path, lines: Int64[np.ndarray, " row"], energy: Column, least: float) -> None:
    """Refuse energies that rise by less than `least` [keV] from row to row."""
    for i in np.flatnonzero(np.diff(energy) < least):
        raise InputError(
            f"{path}:{lines[i + 1]}: energies must ascend, but {energy[i + 1]:g} keV follows {energy[i]:g} keV"
        )


def _columns(
    path: Path, words: tuple[str, ...] = ()
) -> tuple[Int64[np.ndarray, " row"], Column, Column, Shaped[np.ndarray, " row"]]:
    """Line numbers, the two columns, and one of some words or nothing per row."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"{path} cannot be read as a spectrum: {error.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} cannot be read as a spectrum: it is not UTF-8 text") from None
    rows = [(number, line.partition("#")[0].strip()) for number, line in enumerate(text.splitlines(), 1)]
    table = [(number, *_row(f"{path}:{number}", line, words)) for number, line in rows if line]
    if len(table) < 2 and not words:
        raise InputError(f"{path}: a spectrum needs at least two rows of energy and photons, got {len(table)}")
    if not table:
        raise InputError(f"{path}: a spectrum needs at least one row of energy and photons")
    lines, energy, value, word = zip(*table, strict=True)
    return np.array(lines), np.array(energy), np.array(value), np.array(word)


def _row(place: str, line: str, words: tuple[str, ...]) -> tuple[float, float, str]:
    """Energy, value and word of one line."""
    cells = re.split(r"\s*[,;]\s*|\s+", line)
    word = cells.pop() if len(cells) == 3 and cells[2] in words else ""
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
    return energy, value, word


def _edges_around(path: Path, lines: Int64[np.ndarray, " row"], centres: Column) -> Float[np.ndarray, " energy_plus_1"]:
    """Edges of equal bins around their centres."""
    step = (centres[-1] - centres[0]) / (len(centres) - 1)
    even = centres[0] + step * np.arange(len(centres))
    for i in np.flatnonzero(np.abs(centres - even) > _ROUNDING * step):
        raise InputError(
            f"{path}:{lines[i]}: centres must be evenly spaced, here by {step:g} keV, but {centres[i]:g} stands where "
            f"{even[i]:g} would; give edges instead"
        )
    return np.maximum(centres[0] + step * (np.arange(len(centres) + 1) - 0.5), 0.0)
