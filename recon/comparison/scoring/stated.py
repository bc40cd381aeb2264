"""Scores of volumes that hold something else than all basis functions, in the sections of a comparison."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset, open_dataset
from phantomgen.dataset.true_materials import read_true_materials
from phantomgen.dataset.truth import Truth, read_truth
from phantomgen.volume_files.volume import Volume
from recon.comparison.contenders.channel_voxels import ChannelVoxels
from recon.comparison.contenders.model import Model
from recon.comparison.contenders.other_program import OtherProgram
from recon.comparison.scoring.protocols import PROTOCOLS
from recon.comparison.scoring.scores import score
from recon.evaluation.metrics import psnr
from recon.evaluation.quantities import parse_quantities, with_truth
from recon.evaluation.stated_volume import StatedVolume, Statement, refuse_silent, stated_volume
from recon.gaussians.model import GaussianModel
from recon.voxel.model import Voxels
from spectra.errors import InputError

Volumes = Float[np.ndarray, "channel z y x"]


def score_stated(found: StatedVolume, dataset: Dataset, truth: Truth, pseudo: Volumes | None) -> dict[str, Any]:
    """Compute all scores of a volume of another program that exist.

    Parameters
    ----------
    found : the volume
    dataset : open dataset
    truth : of the dataset
    pseudo : see `recon.comparison.scoring.scores.score`

    Returns
    -------
    sections of `recon.comparison.scoring.scores.score`; ``stated`` holds attenuation at energies and densities, by
    protocol and quantity
    """
    model, quantities = found.model, found.quantities
    channels = dataset.spectra.channels
    if found.complete:
        return score(Model(model), dataset, truth, pseudo)
    empty: dict[str, Any] = {"views": {}, "chi_square": {}, "energies": {}, "basis": {}, "stated": {}}
    volumes = model.volume(truth.grid)
    own = {
        name: {
            label: protocol.volume(volume, true)
            for label, volume, true in zip(model.basis_names, volumes, quantities.truth.volumes, strict=True)
        }
        for name, protocol in PROTOCOLS.items()
        if not protocol.pseudo_truth
    }
    if quantities.group == "basis":
        return empty | {"basis": {name: {b: s.get(b, {}) for b in truth.basis_names} for name, s in own.items()}}
    if any(quantity.kind != "channel" for quantity in quantities.each):
        return empty | {"stated": own}
    numbers = [channel_index(quantity.item, channels) for quantity in quantities.each]
    sections = empty
    if sorted(numbers) == list(range(len(channels))):
        order = np.argsort(numbers)
        sections = score(Model(None, ChannelVoxels(model.values[order], model.grid)), dataset, None, None)
    named = {
        name: {channels[n]: row for n, row in zip(numbers, scores.values(), strict=True)}
        for name, scores in own.items()
    }
    return sections | {
        "energies": {name: {c: s.get(c, {}) for c in channels} for name, s in named.items()},
        "stated": {},
    }


def channel_index(item: str, channels: Sequence[str]) -> int:
    """Return the number of a channel that a quantity names.

    Parameters
    ----------
    item : name or number
    channels : names

    Returns
    -------
    number from 0
    """
    return channels.index(item) if item in channels else int(item)


def score_attenuation(
    bases: GaussianModel | Voxels, texts: Sequence[str], dataset: Dataset, truth: Truth
) -> dict[str, dict[str, Any]]:
    """Score the attenuation of basis volumes at the energies that volumes of other programs hold.

    Parameters
    ----------
    bases : volumes of some of the dataset's basis functions
    texts : quantities, such as ``mono:60``
    dataset : open dataset
    truth : of the dataset

    Returns
    -------
    by protocol and quantity; densities are left out, as basis functions do not give them without a choice
    """
    pairs = _attenuation_pairs(bases, texts, ("mono", "hu"), dataset, truth)
    protocols = {name: protocol for name, protocol in PROTOCOLS.items() if pairs and not protocol.pseudo_truth}
    return {name: {label: p.volume(*pair) for label, pair in pairs.items()} for name, p in protocols.items()}


def psnr_of_attenuation(
    bases: GaussianModel | Voxels, texts: Sequence[str], dataset: Dataset, truth: Truth
) -> dict[str, float]:
    """Compute the PSNR of attenuation at the energies that volumes of other programs hold.

    Parameters
    ----------
    bases, texts, dataset, truth : see `score_attenuation`; channels are taken at their effective energy

    Returns
    -------
    PSNR [dB] by ``psnr_<quantity>``
    """
    pairs = _attenuation_pairs(bases, texts, ("mono", "hu", "channel"), dataset, truth)
    return {f"psnr_{label}": value for label, pair in pairs.items() if (value := _psnr(*pair)) is not None}


def psnr_of_stated(found: StatedVolume) -> dict[str, float]:
    """Compute the PSNR of each volume of another program.

    Parameters
    ----------
    found : the volumes

    Returns
    -------
    PSNR [dB] by ``psnr_<quantity>``
    """
    true = found.quantities.truth
    each = zip(true.basis_names, found.model.volume(true.grid), true.volumes, strict=True)
    return {f"psnr_{label}": value for label, *pair in each if (value := _psnr(*pair)) is not None}


def _psnr(volume: Float[np.ndarray, "z y x"], true: Float[np.ndarray, "z y x"]) -> float | None:
    return psnr(float(true.max()), float(np.mean((volume - true) ** 2)))


def _attenuation_pairs(
    bases: GaussianModel | Voxels, texts: Sequence[str], kinds: Sequence[str], dataset: Dataset, truth: Truth
) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Attenuation of basis volumes and its truth [1/mm], by quantity."""
    each = [quantity for text in texts for quantity in parse_quantities(text) if quantity.kind in kinds]
    if not each or not set(bases.basis_names) <= set(truth.basis_names):
        return {}
    volumes = np.zeros_like(truth.volumes)
    for name, volume in zip(bases.basis_names, bases.volume(truth.grid), strict=True):
        volumes[truth.basis_names.index(name)] = volume
    found = {}
    for quantity in each:
        quantities = with_truth([quantity], truth, dataset.spectra, ())
        row = np.zeros(len(volumes)) if quantities.rows is None else quantities.rows[0]
        attenuation = np.tensordot(row, volumes, axes=1).astype(np.float32)
        found[quantity.label] = attenuation, quantities.truth.volumes[0]
    return found


def check_programs(programs: Sequence[OtherProgram], path: Path) -> None:
    """Refuse volumes that could not be scored, before any work; finished ones are read for that.

    Parameters
    ----------
    programs : volumes of other programs, and commands
    path : the dataset

    Raises
    ------
    InputError
        When a volume cannot be read, a statement is missing or wrong, or has no truth in the dataset.
    DatasetError
        When the dataset holds no truth.
    """
    with open_dataset(path) as dataset:
        truth = read_truth(path)
        for program in programs:
            try:
                stated = Statement.of(program.statement, dataset.grid)
                if program.path is not None:
                    stated_volume([program.path], stated, dataset, truth)
                    continue
                if program.suffix in (".npy", ".npz"):  # other formats say more when they are written
                    refuse_silent("its output", Volume(np.zeros((1, 1, 1))), stated)
                if stated.quantities is not None and truth is not None:
                    with_truth(stated.quantities, truth, dataset.spectra, read_true_materials(path))
            except InputError as error:
                raise InputError(f"{program}: {error}") from None
