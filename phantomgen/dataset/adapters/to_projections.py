"""A dataset as projections for other programs."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, Shaped

from phantomgen.dataset.checks.door import value_at
from phantomgen.dataset.file import DARK, FLAT
from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.truth import read_truth
from phantomgen.exporters.projections import Kind, Projections
from spectra.detector.counters import between_thresholds
from spectra.errors import DatasetError, InputError

if TYPE_CHECKING:
    from phantomgen.dataset.reader import Dataset


def to_projections(dataset: "Dataset", kind: Kind, channels: Sequence[str] = ()) -> Projections:
    """Return the training views of a dataset, then its test views, with blind pixels interpolated.

    Parameters
    ----------
    dataset : open dataset
    kind : line integrals of every channel, or counts
    channels : names of the channels; all where left out

    Returns
    -------
    the projections; images are read when they are asked for

    Raises
    ------
    InputError
        When there is no such channel, a channel measures in no pixel, the channels were measured in different views, or
        counts cannot be told without more.
    """
    spectra = dataset.spectra
    names = tuple(channels) or spectra.channels
    for name in names:
        if name not in spectra.channels:
            raise InputError(f"{dataset.path} has no channel {name!r}: it has {', '.join(spectra.channels)}")
    chosen = np.array([spectra.channels.index(name) for name in names])
    if kind == "counts":
        _check_counts(dataset)
    for index, name in zip(chosen, names, strict=True):
        if dataset.mask[index].all():
            raise InputError(f"channel {name} of {dataset.path} measures in no pixel: choose others by --channel")
    parts = [_measured(dataset, dataset.splits[split], chosen, names) for split in ("train", "test")]
    views, (counted, blind) = np.concatenate(parts), (kind == "counts", dataset.mask[chosen])

    def image(view: int) -> Shaped[np.ndarray, "name row column"]:
        found = dataset.load([int(views[view])])[0] if counted else dataset.line_integrals(int(views[view]))
        return found[chosen] if counted else _whole(found[chosen], blind)

    frames = [_frames(dataset, path, chosen) if counted else None for path in (FLAT, DARK)]
    projections = Projections(
        title=dataset.name,
        kind=kind,
        names=names,
        geometry=dataset.geometry[views],
        train=len(parts[0]),
        grid=dataset.grid,
        image=image,
        energies=tuple(float(spectra.effective_energy[c]) for c in chosen),
        flats=frames[0],
        darks=frames[1],
        exposure=dataset.exposure[views][:, chosen] if counted else None,
    )
    return replace(projections, volumes=_true_attenuation(dataset, projections.energies))


def _measured(
    dataset: "Dataset", views: Int[np.ndarray, " view"], chosen: Int[np.ndarray, " channel"], names: tuple[str, ...]
) -> Int[np.ndarray, " _view"]:
    """Views in which the channels were measured."""
    taken = dataset.exposure[views][:, chosen] > 0
    differs = np.flatnonzero((taken != taken[:, :1]).any(axis=0))
    if len(differs):
        raise InputError(
            f"channels {names[0]} and {names[differs[0]]} of {dataset.path} were measured in different views: choose "
            f"channels of the same views, such as --channel {names[0]}"
        )
    return views[taken[:, 0]]


def _whole(
    images: Shaped[np.ndarray, "name row column"], blind: Shaped[np.ndarray, "name row column"]
) -> Shaped[np.ndarray, "name row column"]:
    """Images without values that are not numbers."""
    return np.stack([inpainted(image, unseen) for image, unseen in zip(images, blind, strict=True)])


def _check_counts(dataset: "Dataset") -> None:
    """Refuse counts that a folder without our spectra could not be read by."""
    if dataset.spectra.dead_time is not None:
        raise InputError(f"the counts of {dataset.path} miss photons by dead time, which no other program knows: "
                         "export line-integrals, which are corrected")  # fmt: skip
    if dataset.air is not None or dataset.spectra.units != "counts":
        raise InputError(f"{dataset.path} holds no counts with flats: export line-integrals")


def _frames(
    dataset: "Dataset", path: str, chosen: Int[np.ndarray, " channel"]
) -> Shaped[np.ndarray, "f name row col"] | None:
    """Flats or darks of the channels."""
    if path not in dataset.file:
        return None
    frames = value_at(dataset.file, path)
    return (np.stack([*map(between_thresholds, frames)]) if dataset.subtracts else frames)[:, chosen]


def _true_attenuation(
    dataset: "Dataset", energies: tuple[float, ...]
) -> Callable[[int], Float[np.ndarray, "z y x"]] | None:
    """Function that returns the true attenuation at the effective energy of a channel [1/mm]; None without a truth."""
    if "truth" not in dataset.file:
        return None

    def volume(number: int) -> Shaped[np.ndarray, "z y x"]:
        truth = read_truth(dataset.path)
        if truth is None:
            raise DatasetError(f"{dataset.path} holds no truth to export")
        weights = dataset.spectra.basis.evaluate(np.array([energies[number]]))[:, 0]
        return np.einsum("b,bzyx->zyx", weights, truth.volumes)

    return volume
