"""All scores of one model: test views, volumes at each channel's mean energy, basis volumes, materials, agreement."""

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from phantomgen.dataset.truth import Truth
from recon.comparison.contenders.model import Model
from recon.comparison.scoring.lpips import perceptual_distance
from recon.comparison.scoring.material_maps import score_maps
from recon.comparison.scoring.protocols import PROTOCOLS, Protocol, image_ssim
from recon.data.measurements import read_measurements
from recon.evaluation.metrics import HeldOutView, log_projections, psnr, score_projections
from recon.evaluation.scoring import held_out_views, score_truth
from spectra.basis.basis import Basis

Volumes = Float[np.ndarray, "channel z y x"]


def score(model: Model, dataset: Dataset, truth: Truth | None, pseudo: Volumes | None) -> dict[str, Any]:
    """Compute all scores of a model as plain numbers; those that do not exist are None.

    Parameters
    ----------
    model : result of a method
    dataset : with the test views, and all channels
    truth : of the dataset; None where it has none
    pseudo : of `recon.comparison.campaign.pseudo_truth` [1/mm], which one protocol takes as the truth

    Returns
    -------
    ``views``, ``energies`` and ``basis``: by protocol and channel or basis; ``chi_square``: by channel;
    ``materials`` and ``cross_talk``: see `recon.evaluation.metrics.score_materials`; ``maps``: see
    `recon.comparison.scoring.material_maps`.
    """
    found: dict[str, Any] = {"views": {}, "chi_square": {}, "energies": {}, "basis": {}}
    channels = dataset.spectra.channels
    if len(dataset.splits["test"]):
        found["views"] = _score_views(model, dataset)
        agreement = score_projections(_views(model, dataset), channels)
        found["chi_square"] = {
            name: {"all": s["chi_square_all"], "away": s["chi_square_away"]} for name, s in agreement.items()
        }
    if truth is not None and model.bases is not None:
        materials = score_truth(truth, model.bases)
        found |= {"materials": materials["materials"], "cross_talk": materials["cross_talk"]}
        found["maps"] = score_maps(model.bases, dataset)
        volumes = dict(zip(model.bases.basis_names, model.bases.volume(truth.grid), strict=True))
        pairs = [(name, volumes.get(name), true) for name, true in zip(truth.basis_names, truth.volumes, strict=True)]
        found["basis"] = {name: _score_volumes(p, pairs) for name, p in PROTOCOLS.items()}
    attenuation = _attenuation(model, dataset)
    if attenuation is not None:
        exact = _true_attenuation(truth, dataset)
        for name, protocol in PROTOCOLS.items():
            true = pseudo if protocol.pseudo_truth else exact
            if true is not None and true.shape == attenuation.shape:
                found["energies"][name] = _score_volumes(protocol, zip(channels, attenuation, true, strict=True))
    return found


def _score_volumes(protocol: Protocol, pairs: Iterable[tuple[str, np.ndarray | None, np.ndarray]]) -> dict[str, Any]:
    """Scores of volumes by name; a volume that is missing has none."""
    return {name: {} if volume is None else protocol.volume(volume, true) for name, volume, true in pairs}


def _views(model: Model, dataset: Dataset) -> Iterator[HeldOutView]:
    own = model.views or model.channels
    if own is not None:
        yield from own.held_out_views(dataset)
    elif model.bases is not None:
        names, basis = model.bases.basis_names, dataset.spectra.basis
        used = Basis(tuple(f for f in basis.functions if f.name in names), basis.reference_energy)
        yield from held_out_views(dataset.with_basis(used), model.bases)


def _score_views(model: Model, dataset: Dataset) -> dict[str, Any]:
    """Means over the test views of ``psnr`` [dB], ``ssim`` and ``lpips`` of projections, by protocol and channel."""
    channels, peaks = dataset.spectra.channels, largest_projections(dataset)
    rows: dict[str, list[list[_Row]]] = {name: [[] for _ in channels] for name in PROTOCOLS}
    for view in _views(model, dataset):
        predicted = log_projections(view.expected, view.open_beam)
        measured = log_projections(view.counts, view.open_beam)
        for name, protocol in PROTOCOLS.items():
            for c, peak in enumerate(peaks):
                if (view.open_beam[c] > 0).any():
                    rows[name][c].append(_row(*protocol.view(predicted[c], measured[c], peak)))
    return {
        name: {channel: _summary(rows[name][c], protocol.own_scale) for c, channel in enumerate(channels)}
        for name, protocol in PROTOCOLS.items()
    }


_Row = tuple[float, float, float | None]  # mean square error, SSIM, LPIPS of a view


def _row(image: Float[np.ndarray, "row column"], truth: Float[np.ndarray, "row column"]) -> _Row:
    lpips = perceptual_distance()
    perceived = None if lpips is None else lpips(image, truth)
    return float(np.mean((image - truth) ** 2)), image_ssim(image, truth), perceived


def _summary(rows: list[_Row], by_view: bool) -> dict[str, float | None]:
    if not rows:
        return {"psnr": None, "ssim": None, "lpips": None}
    errors = [row[0] for row in rows]
    each = [value for value in (psnr(1.0, error) for error in errors) if value is not None]
    perceived = [row[2] for row in rows if row[2] is not None]
    return {
        "psnr": (float(np.mean(each)) if each else None) if by_view else psnr(1.0, float(np.mean(errors))),
        "ssim": float(np.mean([row[1] for row in rows])),
        "lpips": float(np.mean(perceived)) if perceived else None,
    }


def largest_projections(dataset: Dataset) -> list[float]:
    """Find the largest measured log projection of each channel in the test views.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    values by channel [no unit]; 1 where there is no positive one
    """
    peaks = np.zeros(len(dataset.spectra.channels))
    for view in dataset.splits["test"]:
        measured = read_measurements(dataset, np.array([view]), 1)
        open_beam = measured.exposure[0, :, None, None] * measured.gains * measured.open_beam
        peaks = np.maximum(peaks, log_projections(measured.counts[0], open_beam).max(axis=(1, 2)))
    return [float(peak) if peak > 0 else 1.0 for peak in peaks]


def _attenuation(model: Model, dataset: Dataset) -> Volumes | None:
    """Volumes at the mean energy of each channel [1/mm]."""
    if model.channels is not None:
        return model.channels.values
    if model.bases is None:
        return None
    return _at_energies(model.bases.volume(dataset.grid), model.bases.basis_names, dataset)


def _true_attenuation(truth: Truth | None, dataset: Dataset) -> Volumes | None:
    return None if truth is None else _at_energies(truth.volumes, truth.basis_names, dataset)


def _at_energies(volumes: Float[np.ndarray, "basis z y x"], names: tuple[str, ...], dataset: Dataset) -> Volumes | None:
    """Attenuation at the mean energy of each channel; None where a basis is not the dataset's or a channel is blind."""
    basis, energies = dataset.spectra.basis, dataset.spectra.effective_energy
    known = {function.name: row for function, row in zip(basis.functions, basis.evaluate(energies), strict=True)}
    if not set(names) <= set(known) or np.isnan(energies).any():
        return None
    return np.einsum("mc,mzyx->czyx", np.stack([known[name] for name in names]), volumes)
