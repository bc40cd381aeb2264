"""Settings files of scanners: lines ``key=value``, in sections or not."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from spectra.errors import InputError

_LARGEST = 4 << 20  # bytes; a settings file has some thousand


@dataclass(frozen=True)
class Keys:
    """Keys of a settings file.

    Parameters
    ----------
    path : of the file, for messages
    values : text by key; of a key that stands twice, the first
    """

    path: Path
    values: Mapping[str, str]

    def text(self, name: str) -> str:
        """Return the text of a key, empty where it is missing.

        Parameters
        ----------
        name : of the key

        Returns
        -------
        the text
        """
        return self.values.get(name, "")

    def number(self, name: str, default: float | None = None) -> float:
        """Return the number of a key.

        Parameters
        ----------
        name : of the key
        default : where the key is missing or empty; None to refuse that

        Returns
        -------
        the number

        Raises
        ------
        InputError
            When the key is missing, or its value is no finite number.
        """
        text = self.text(name).strip()
        if not text:
            if default is None:
                raise InputError(f"{self.path}: the key {name} is missing")
            return default
        try:
            value = float(text.split()[0].replace(",", "."))
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(f"{self.path}: {name} must be a number, got {text!r}")
        return value

    def optional(self, name: str) -> float | None:
        """Return the number of a key that may be missing, or may be 0 where it is not known.

        Parameters
        ----------
        name : of the key

        Returns
        -------
        the number; None where it is missing or 0
        """
        return self.number(name, 0.0) or None

    def count(self, name: str, most: int = 100_000) -> int:
        """Return the number of things that a key states.

        Parameters
        ----------
        name : of the key
        most : largest number that is believed

        Returns
        -------
        the number

        Raises
        ------
        InputError
            When it is no whole number from 1 on, or not to be believed.
        """
        value = self.number(name)
        if value != int(value) or not 1 <= value <= most:
            raise InputError(f"{self.path}: {name} must be a whole number from 1 to {most}, got {self.text(name)!r}")
        return int(value)


def read_keys(path: Path, sign: str) -> Keys:
    """Read the keys of a settings file.

    Parameters
    ----------
    path : of the file
    sign : text that every file of the format holds

    Returns
    -------
    the keys

    Raises
    ------
    InputError
        When the file is missing, or is something else.
    """
    if not path.is_file():
        raise InputError(f"there is no file {path}")
    with path.open("rb") as file:
        data = file.read(_LARGEST + 1)
    text = data.decode("utf-8-sig", errors="replace")
    if len(data) > _LARGEST or "\0" in text or sign not in text:
        raise InputError(f"{path} is no such settings file: it lacks {sign}")
    found: dict[str, str] = {}
    for line in text.splitlines():
        key, equals, value = line.partition("=")
        if equals:
            found.setdefault(key.strip(), value.strip())
    return Keys(path, found)
