"""The spectra of a dataset in other basis functions than those it states."""

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from phantomgen.dataset.beam_profile import StoredProfile
from spectra.basis.basis import Basis
from spectra.energy.bin_split import split_bins

if TYPE_CHECKING:
    from phantomgen.dataset.spectral_model import Spectra


def in_basis(spectra: "Spectra", basis: Basis) -> "Spectra":
    """The same source and detector, and other functions of energy.

    Parameters
    ----------
    spectra : as stored
    basis : functions to use; bins are cut where one has an edge, so that expected counts are continuous in its energy
    """
    split = split_bins(spectra.edges, spectra.energy, basis.breaks)
    parents = split.parents
    profile = spectra.profile
    if profile is not None:
        profile = StoredProfile(profile.names, profile.attenuation[:, parents], profile.lengths)
    return replace(
        spectra,
        energy=split.nodes,
        edges=split.edges,
        source=spectra.source[parents] * split.shares,
        response=np.ascontiguousarray(spectra.response[:, parents]),
        basis=basis,
        basis_values=basis.evaluate(split.nodes),
        variance=None if spectra.variance is None else spectra.variance[:, parents],
        profile=profile,
    )
