"""Scores of a result: against the truth where there is one, against held-out counts in any case.

All scores are computed in float64 from plain arrays. A score that does not exist (a ratio whose denominator is zero, a
PSNR without any error, SSIM of a volume narrower than its window) is None, never NaN or infinity, so that every result
is valid JSON; `rmse` distinguishes a perfect volume (0) from a truth that is zero everywhere.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Real
from scipy import ndimage

from phantomgen.dataset.inpainting import inpainted
from recon.data.partial_volume import LEAST_COUNTS
from recon.data.projection_edges import edge_mask
from spectra.errors import InputError

SSIM_WINDOW = 11  # pixels: 2 int(3.5 sigma + 0.5) + 1 with sigma = 1.5, as in Wang et al. 2004
SHALLOW = 0.02  # log projection; rays with less pass beside the object; chosen by hand, not measured
PURE = 0.999  # no unit; least fraction of a voxel that one material fills for the voxel to count as pure
_LEAST_EXPECTED = 1e-9  # counts; with this a count where the model expects none makes chi-square large, not infinite

Scores = dict[str, float | None]


def score_volume(volume: Real[np.ndarray, "z y x"], truth: Real[np.ndarray, "z y x"]) -> Scores:
    """Score one basis over the whole volume.

    Parameters
    ----------
    volume, truth : coefficients of one basis [1/mm]

    Returns
    -------
    ``psnr`` 10 log10(max(truth)^2 / MSE) [dB]; ``psnr_scaled`` the PSNR after multiplication by the best scalar
    ``scale``; ``psnr_zero`` that of a volume of zeros; ``ssim`` mean structural similarity of the axial slices whose
    truth is not zero (Gaussian window of sigma 1.5, range max(truth); Wang et al. 2004, doi:10.1109/TIP.2003.819861);
    ``bias`` mean error and ``rmse`` [1/mm]. A truth without a positive value has no PSNR, SSIM or scale: None.
    """
    volume, truth = _comparable(volume, truth)
    error = volume - truth
    energy, overlap = np.vdot(volume, volume), np.vdot(volume, truth)
    scale = float(overlap / energy) if energy > 0 else 0.0
    peak = truth.max(initial=0.0)
    return {
        "psnr": psnr(peak, _mean_square(error)),
        "psnr_scaled": psnr(peak, _mean_square(scale * volume - truth)),
        "psnr_zero": psnr(peak, _mean_square(truth)),
        "scale": scale if peak > 0 else None,
        "ssim": _ssim_of_slices(volume, truth, peak),
        "bias": float(error.mean()),
        "rmse": float(np.sqrt(_mean_square(error))),
    }


def score_basis_volumes(
    volumes: Real[np.ndarray, "basis z y x"], truth: Real[np.ndarray, "basis z y x"], names: Sequence[str]
) -> dict[str, Scores]:
    """Score every basis over the whole volume.

    Parameters
    ----------
    volumes, truth : coefficients of all bases [1/mm]
    names : names of the bases

    Returns
    -------
    `score_volume` of each basis, by its name
    """
    return {name: score_volume(v, t) for name, v, t in zip(names, volumes, truth, strict=True)}


def score_elsewhere(
    volumes: Real[np.ndarray, "basis z y x"],
    truth: Real[np.ndarray, "basis z y x"],
    names: Sequence[str],
    marked: Bool[np.ndarray, "z y x"],
) -> dict[str, Scores]:
    """Score every basis in the voxels that are not marked.

    Parameters
    ----------
    volumes, truth : coefficients of all bases [1/mm]
    names : names of the bases
    marked : voxels to leave out

    Returns
    -------
    by basis ``psnr_elsewhere`` [dB], whose peak is the largest true value among these voxels, ``bias_elsewhere`` and
    ``rmse_elsewhere`` [1/mm]
    """
    scores = {}
    for name, volume, true in zip(names, volumes, truth, strict=True):
        error = np.asarray(volume[~marked], np.float64) - true[~marked]
        mean_square = _mean_square(error) if error.size else None
        scores[name] = {
            "psnr_elsewhere": psnr(float(true[~marked].max(initial=0.0)), mean_square),
            "bias_elsewhere": _ratio(error.sum(), error.size),
            "rmse_elsewhere": None if mean_square is None else float(np.sqrt(mean_square)),
        }
    return scores


def score_materials(
    volumes: Real[np.ndarray, "basis z y x"],
    fractions: Real[np.ndarray, "material z y x"],
    coefficients: Float[np.ndarray, "material basis"],
    material_names: Sequence[str],
    basis_names: Sequence[str],
    full: float = 1.0,
) -> dict[str, Any]:
    """Score bias and noise inside each material, and cross-talk between bases.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    fractions : fraction of each voxel that a material fills, in units of 1 / `full`
    coefficients : true coefficients of the materials [1/mm]
    material_names : names of the materials
    basis_names : names of the bases
    full : value of a full voxel, 65535 for fractions of `phantomgen.dataset.truth.Truth`

    Returns
    -------
    ``materials``: by material the number of ``voxels`` used (pure ones, see `pure_voxels`), and by basis ``true``,
    ``mean``, ``bias`` and ``sd`` [1/mm]; None where no voxel is left. ``cross_talk``: see `cross_talk`.
    """
    table, means, present = {}, [], []
    for name, fraction, true in zip(material_names, fractions, coefficients, strict=True):
        inside = pure_voxels(fraction, full)
        values = np.asarray(volumes[:, inside], dtype=np.float64)
        table[name] = {"voxels": values.shape[1]} | {
            basis: _spread(row, float(t)) for basis, row, t in zip(basis_names, values, true, strict=True)
        }
        if values.size:
            means.append(values.mean(axis=1))
            present.append(true)
    return {
        "materials": table,
        "cross_talk": cross_talk(_rows(means, basis_names), _rows(present, basis_names), basis_names),
    }


def _rows(values: Sequence[np.ndarray], names: Sequence[str]) -> Float[np.ndarray, "material basis"]:
    """Values of each material and basis as an array, also of no material."""
    return np.array(values, dtype=np.float64).reshape(-1, len(names))


def cross_talk(
    means: Float[np.ndarray, "material basis"], true: Float[np.ndarray, "material basis"], names: Sequence[str]
) -> dict[str, dict[str, float]] | None:
    """Compute how mean coefficients of each basis depend on the true coefficients of all bases.

    Parameters
    ----------
    means : mean coefficients in each material [1/mm]
    true : true coefficients of each material [1/mm]
    names : names of the bases

    Returns
    -------
    matrix A of the least-squares solution of mean = A true over the materials [no unit], as basis of the result ->
    true basis -> number: the identity for a perfect result; None where the materials do not span the basis
    """
    scale = np.abs(true).max(axis=0, initial=0.0) if true.size else np.zeros(len(names))
    if not scale.all() or np.linalg.matrix_rank(true / scale, tol=1e-3) < len(names):
        return None
    matrix = (np.linalg.lstsq(true / scale, means, rcond=None)[0] / scale[:, None]).T
    return {name: dict(zip(names, map(float, row), strict=True)) for name, row in zip(names, matrix, strict=True)}


def pure_voxels(fraction: Real[np.ndarray, "z y x"], full: float = 1.0) -> Bool[np.ndarray, "z y x"]:
    """Find the voxels that one material fills, with all neighbours at most two voxels away along each axis.

    Parameters
    ----------
    fraction : fraction of each voxel that the material fills, in units of 1 / `full`
    full : value of a full voxel

    Returns
    -------
    mask of the voxels that are filled by more than `PURE`, as are all those neighbours
    """
    return ndimage.minimum_filter(fraction, size=5, mode="constant", cval=0) > PURE * full


@dataclass(frozen=True, eq=False)
class HeldOutView:
    """One view that the fit has not used.

    Parameters
    ----------
    counts : measured counts y
    expected : counts Y that the model expects
    open_beam : counts without an object; a pixel with 0 is blind and left out
    away : mask of the rays away from edges
    marked : mask of the rays through voxels whose bases the counts do not determine; None where there are none
    spread : variance of the difference of measured and expected counts, over their mean; None where it is 1, as that of
        Poisson counts whose flat field is exact
    """

    counts: Real[np.ndarray, "channel row column"]
    expected: Real[np.ndarray, "channel row column"]
    open_beam: Real[np.ndarray, "channel row column"]
    away: Bool[np.ndarray, "row column"]
    marked: Bool[np.ndarray, "row column"] | None = None
    spread: Real[np.ndarray, "channel row column"] | None = None

    @classmethod
    def of(
        cls,
        counts: Real[np.ndarray, "channel row column"],
        expected: Real[np.ndarray, "channel row column"],
        open_beam: Real[np.ndarray, "channel row column"],
        distance: float = 2.0,
        marked: Bool[np.ndarray, "row column"] | None = None,
        spread: Real[np.ndarray, "channel row column"] | None = None,
    ) -> "HeldOutView":
        """Make a view, with edges from the log projections of the model.

        Parameters
        ----------
        counts, expected, open_beam : see `HeldOutView`
        distance : least distance of rays away from edges [pixel]
        marked, spread : see `HeldOutView`

        Returns
        -------
        the view
        """
        logs = log_projections(expected, open_beam)
        whole = np.stack([inpainted(image, air <= 0) for image, air in zip(logs, open_beam, strict=True)])
        return cls(counts, expected, open_beam, edge_mask(whole, distance), marked, spread)


def score_projections(views: Iterable[HeldOutView], channel_names: Sequence[str]) -> dict[str, Scores]:
    """Score how well a model predicts views that it has not used, one view at a time.

    Parameters
    ----------
    views : the views
    channel_names : names of the channels

    Returns
    -------
    By channel: ``psnr`` of the log projections [dB], its peak the largest expected log projection; ``psnr_noise`` the
    PSNR of the true model, from var(log y) = v / Y; ``chi_square_all`` mean of (y - Y)^2 / (v Y) over all rays and
    ``chi_square_away`` over rays away from edges, both 1 for counts of the true model, whose variance is v Y with v the
    `spread` of `HeldOutView`; ``away`` the part of
    these rays, ``rays_away`` their number, and ``counts_away`` the mean of their expected counts, with 0 for rays
    beside the object: a relative model error e inside the object adds e^2 times that to ``chi_square_away``. Where rays
    are marked, also ``chi_square_marked``, ``rays_marked`` and ``counts_marked`` of these. In logarithms counts below
    0.5 are taken as 0.5. A channel without photons scores None.
    """
    table = np.array([_sums_of_view(view) for view in views]).reshape(-1, len(_ViewSums._fields), len(channel_names))
    peaks = table[:, -1].max(axis=0, initial=0.0)
    scores = {}
    for name, peak, total in zip(channel_names, peaks, table.sum(axis=0).T, strict=True):
        sums = _ViewSums(*total)
        scores[name] = {
            "psnr": psnr(peak, _ratio(sums.square, sums.rays)),
            "psnr_noise": psnr(peak, _ratio(sums.variance, sums.rays)),
            "chi_square_all": _ratio(sums.chi_all, sums.rays),
            "chi_square_away": _ratio(sums.chi_away, sums.rays_away),
            "away": _ratio(sums.rays_away, sums.rays),
            "rays_away": int(sums.rays_away) or None,
            "counts_away": _ratio(sums.counts_away, sums.rays_away),
        }
        if sums.rays_marked:
            scores[name] |= {
                "chi_square_marked": _ratio(sums.chi_marked, sums.rays_marked),
                "rays_marked": int(sums.rays_marked),
                "counts_marked": _ratio(sums.counts_marked, sums.rays_marked),
            }
    return scores


def psnr(peak: float, mean_square_error: float | None) -> float | None:
    """Compute the peak signal-to-noise ratio, 10 log10(peak^2 / MSE).

    Parameters
    ----------
    peak : largest true value
    mean_square_error : mean square error, in the unit of the peak squared

    Returns
    -------
    PSNR [dB]; None where there is no peak or no error
    """
    if mean_square_error is None or not (peak > 0 and mean_square_error > 0):
        return None
    return float(20 * np.log10(peak) - 10 * np.log10(mean_square_error))


def _comparable(volume: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if volume.shape != truth.shape:
        raise InputError(f"a volume of shape {volume.shape} cannot be compared with a truth of shape {truth.shape}")
    if not np.isfinite(volume).all():
        raise InputError(f"the volume to score has {np.count_nonzero(~np.isfinite(volume))} voxels that are not finite")
    return np.asarray(volume, dtype=np.float64), np.asarray(truth, dtype=np.float64)


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(np.square(values)))


def _ratio(total: float, number: float) -> float | None:
    return float(total / number) if number > 0 else None


def _ssim_of_slices(volume: np.ndarray, truth: np.ndarray, peak: float) -> float | None:
    """Mean over the axial slices whose truth is not zero."""
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - a third of a second

    slices = np.flatnonzero(truth.any(axis=(1, 2)))
    if peak <= 0 or min(truth.shape[1:]) < SSIM_WINDOW:
        return None
    options = {"data_range": peak, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return float(np.mean([structural_similarity(volume[z], truth[z], **options) for z in slices]))


def _spread(values: np.ndarray, true: float) -> Scores:
    """Mean, bias and standard deviation of the values of one basis in one material."""
    if not values.size:
        return {"true": true, "mean": None, "bias": None, "sd": None}
    mean = float(values.mean())
    return {"true": true, "mean": mean, "bias": mean - true, "sd": float(values.std())}


def log_projections(expected: np.ndarray, open_beam: np.ndarray) -> np.ndarray:
    """Compute the logarithm of open beam over expected counts of at least `LEAST_COUNTS`.

    Parameters
    ----------
    expected : expected counts
    open_beam : counts without an object

    Returns
    -------
    log projections [no unit], 0 for blind pixels
    """
    logged = np.maximum(expected, LEAST_COUNTS).astype(np.float64)
    return np.log(np.where(open_beam > 0, open_beam, logged) / logged)


class _ViewSums(NamedTuple):
    """Sums over rays, as arrays by channel or as numbers of one channel; `peak` is the largest log projection."""

    rays: Any
    rays_away: Any
    chi_all: Any
    chi_away: Any
    square: Any
    variance: Any
    counts_away: Any
    rays_marked: Any
    chi_marked: Any
    counts_marked: Any
    peak: Any


def _sums_of_view(view: HeldOutView) -> _ViewSums:
    """Sums of one view."""
    seen = view.open_beam > 0
    counts = np.asarray(view.counts, dtype=np.float64)
    expected = np.maximum(np.asarray(view.expected, dtype=np.float64), _LEAST_EXPECTED)
    logged = np.maximum(expected, LEAST_COUNTS)
    projection = log_projections(expected, view.open_beam)
    away = seen & view.away
    variance = expected if view.spread is None else expected * view.spread
    chi_square = (counts - expected) ** 2 / variance
    log_error = np.log(np.maximum(counts, LEAST_COUNTS) / logged)
    marked = np.zeros_like(seen) if view.marked is None else seen & view.marked

    def total(values: np.ndarray) -> np.ndarray:
        return values.sum(axis=(1, 2))

    return _ViewSums(
        rays=total(seen * 1),
        rays_away=total(away * 1),
        chi_all=total(seen * chi_square),
        chi_away=total(away * chi_square),
        square=total(seen * log_error**2),
        variance=total(seen * variance / expected / logged),
        counts_away=total((away & (projection > SHALLOW)) * expected),
        rays_marked=total(marked * 1),
        chi_marked=total(marked * chi_square),
        counts_marked=total(marked * expected),
        peak=projection.max(axis=(1, 2)),
    )
