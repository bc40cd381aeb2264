"""Scores of the material maps that `recon.segmentation` finds in a model."""

from typing import Any

import numpy as np

from phantomgen.dataset.reader import Dataset
from recon.data.measurements import read_measurements
from recon.gaussians.model import GaussianModel
from recon.segmentation.result import Options
from recon.segmentation.scoring.reference import read_reference
from recon.segmentation.scoring.scores import score
from recon.segmentation.segment import segment_subject
from recon.segmentation.subject import Subject
from recon.voxel.model import Voxels
from spectra.basis.basis import Basis
from spectra.errors import Error


def score_maps(bases: GaussianModel | Voxels, dataset: Dataset) -> dict[str, Any]:
    """Score the material maps, and their renderings in colour.

    Parameters
    ----------
    bases : volumes of some of the dataset's basis functions
    dataset : open dataset with a truth

    Returns
    -------
    ``dice`` by material, ``mean_dice``, and similarity of ``rgb_views`` and ``rgb_slices``; empty where nothing can be
    scored
    """
    known = dataset.spectra.basis
    functions = tuple(f for f in known.functions if f.name in bases.basis_names)
    if tuple(f.name for f in functions) != bases.basis_names:
        return {}
    basis = Basis(functions, known.reference_energy)
    transmission = read_measurements(dataset.with_basis(basis), np.array([0]), separable=False).transmission
    model = bases if isinstance(bases, GaussianModel) else None
    subject = Subject.of(bases.volume(dataset.grid), dataset.grid, basis, transmission, model)
    try:
        found = segment_subject(subject, Options())
        reference = read_reference(dataset.path, found)
    except Error:  # nothing but air, or a truth on another grid
        return {}
    if reference is None:
        return {}
    scores = score(found, reference)
    dice = {name: row["dice"] for name, row in scores["materials"].items() if row["voxels"]}
    return {"dice": dice, **{key: scores[key] for key in ("mean_dice", "rgb_views", "rgb_slices")}}
