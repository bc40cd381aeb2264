"""Truth of a scan whose objects move or whose materials change: basis volumes of each phase, and signals."""

from collections.abc import Mapping
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float, Float32

from phantomgen.dataset.checks.door import group_at, has, value_at
from phantomgen.dataset.file import damaged_file, open_file
from phantomgen.dataset.layout import new_group, put, text_of


def write_signals(truth: h5py.Group, signals: Mapping[str, Float[np.ndarray, " view"]]) -> None:
    """Write ``/truth/time``.

    Parameters
    ----------
    truth : group of the truth
    signals : value at each view, by name
    """
    group = new_group(truth, "time", "NXcollection")
    put(group, "signal_name", np.array(list(signals), dtype=object))
    put(group, "signal", np.stack(list(signals.values())))


def read_signals(path: Path | str) -> dict[str, Float[np.ndarray, " view"]]:
    """Read the signals that drove the objects.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    value at each view, by name; empty where nothing changed
    """
    with open_file(Path(path), "truth") as file, damaged_file(Path(path)):
        if not has(file, "truth/time"):
            return {}
        group = group_at(file, "truth/time")
        names = [text_of(name) for name in value_at(group, "signal_name")]
        return dict(zip(names, value_at(group, "signal"), strict=True))


def read_phases(path: Path | str) -> Float32[np.ndarray, "phase basis z y x"] | None:
    """Read the true basis volumes of all phases.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    volumes [1/mm]; None where the truth has no phases
    """
    with open_file(Path(path), "truth") as file, damaged_file(Path(path)):
        return value_at(file, "truth/phases/data") if has(file, "truth/phases") else None
