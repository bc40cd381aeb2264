"""Beam profile of a dataset: differences of the open beam over the panel."""

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.dataset.checks.door import find_group, value_at
from phantomgen.dataset.layout import new_group, put, text_of
from spectra.errors import DatasetError

PROFILE = "/entry/spectra/profile"


@dataclass(frozen=True, eq=False)
class StoredProfile:
    """Absorbers before the object: the beam at a pixel is that at the panel's centre times exp(-sum_p mu_p t_p).

    Parameters
    ----------
    names : of the absorbers
    lengths : thickness beyond that on the ray to the panel's centre [mm]; may be negative
    attenuation : of each absorber in each energy bin [1/mm]
    """

    names: tuple[str, ...]
    lengths: Float[np.ndarray, "part row column"]
    attenuation: Float[np.ndarray, "part energy"]

    def check(self, path: Path, pixels: tuple[int, ...], energies: int) -> None:
        """Refuse arrays that do not fit the dataset.

        Parameters
        ----------
        path : the dataset, for the message
        pixels : rows and columns of the panel
        energies : number of energy bins

        Raises
        ------
        DatasetError
            When an array has the wrong shape.
        """
        parts = len(self.names)
        for name, array, shape in (
            ("thickness", self.lengths, (parts, *pixels)),
            ("mu", self.attenuation, (parts, energies)),
        ):
            if array.shape != shape:
                raise DatasetError(f"{path}: {PROFILE}/{name} has shape {array.shape}, expected {shape}")
            if not np.isfinite(array).all():
                raise DatasetError(f"{path}: {PROFILE}/{name} holds a value that is not a number")


def write_profile(spectra: h5py.Group, profile: StoredProfile) -> None:
    """Write a profile beside the spectra.

    Parameters
    ----------
    spectra : group of the spectra
    profile : the profile
    """
    group = new_group(spectra, "profile", "NXcollection")
    put(group, "name", np.array(profile.names, dtype=object))
    put(group, "thickness", profile.lengths, "mm")
    put(group, "mu", profile.attenuation, "1/mm")


def read_profile(file: h5py.File) -> StoredProfile | None:
    """Read the profile of a dataset.

    Parameters
    ----------
    file : open dataset

    Returns
    -------
    the profile; None where the dataset has none
    """
    group = find_group(file, PROFILE)
    if group is None:
        return None
    names, lengths, attenuation = (value_at(group, name) for name in ("name", "thickness", "mu"))
    return StoredProfile(tuple(text_of(name) for name in names), lengths, attenuation)
