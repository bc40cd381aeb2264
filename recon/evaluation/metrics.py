"""How good a result is: against the truth where there is one, against held-out counts where there is none.

Everything is computed in float64 from plain arrays. A number that does not exist (a ratio whose denominator is zero, a
PSNR without any error, SSIM of a volume narrower than its window) is None, never NaN or infinity, so that every result
is valid JSON; `rmse` tells a perfect volume (0) from a truth that is zero everywhere.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Real
from scipy import ndimage

from recon.data.inpainting import inpainted
from recon.data.projection_edges import edge_mask
from spectra.errors import InputError

SSIM_WINDOW = 11  # pixels: 2 int(3.5 sigma + 0.5) + 1 with sigma = 1.5, as in Wang et al. 2004
SHALLOW = 0.02  # largest log projection of a ray that passes by the object
_FEWEST_EXPECTED = 1e-9  # a count where the model expects none makes chi-square huge, not infinite
_FEWEST_LOGGED = 0.5  # counts below are raised to this before a logarithm

Scores = dict[str, float | None]


def score_volume(volume: Real[np.ndarray, "z y x"], truth: Real[np.ndarray, "z y x"]) -> Scores:
    """Scores of one basis over the whole volume.

    Parameters
    ----------
    volume, truth : coefficients of one basis [1/mm]

    Returns
    -------
    ``psnr`` 10 log10(max(truth)^2 / MSE) [dB]; ``psnr_scaled`` the same after the scalar ``scale`` that makes it best;
    ``psnr_zero`` that of a volume of zeros; ``ssim`` mean structural similarity of the axial slices that hold truth
    (Gaussian window of sigma 1.5, range max(truth); Wang et al. 2004, doi:10.1109/TIP.2003.819861); ``bias`` mean error
    and ``rmse`` [1/mm]. A truth without a positive value has no PSNR, SSIM or scale: None.
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
    """`score_volume` of every basis, by its name."""
    return {name: score_volume(v, t) for name, v, t in zip(names, volumes, truth, strict=True)}


def score_elsewhere(
    volumes: Real[np.ndarray, "basis z y x"],
    truth: Real[np.ndarray, "basis z y x"],
    names: Sequence[str],
    marked: Bool[np.ndarray, "z y x"],
) -> dict[str, Scores]:
    """``psnr_elsewhere``, ``bias_elsewhere`` and ``rmse_elsewhere`` of every basis in the voxels that are not marked.

    The peak of the PSNR is the largest true value among these.
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
    """Bias and noise inside each material, and how much of one basis shows up in another.

    Parameters
    ----------
    volumes : coefficients [1/mm]
    fractions : part of each voxel that a material fills, `full` = all
    coefficients : true coefficients of the materials [1/mm]
    full : 65535 for fractions as `phantomgen.dataset.truth.Truth` keeps them

    Returns
    -------
    ``materials``: by material the number of ``voxels`` used (those that it fills by more than 0.999, and so do all
    voxels at most two away along each axis), and by basis ``true``, ``mean``, ``bias`` and ``sd`` [1/mm]; None where no
    voxel is left. ``cross_talk``: row `m` says how mean coefficients of basis `m` follow the true coefficients of each
    basis [no unit], the least-squares solution of mean = A true over the materials: 1 on the diagonal and 0 elsewhere
    when all is well; None where the materials present do not span the basis.
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
    """A of mean = A true in the least-squares sense, as result basis -> true basis -> number."""
    scale = np.abs(true).max(axis=0, initial=0.0) if true.size else np.zeros(len(names))
    if not scale.all() or np.linalg.matrix_rank(true / scale, tol=1e-3) < len(names):
        return None
    matrix = (np.linalg.lstsq(true / scale, means, rcond=None)[0] / scale[:, None]).T
    return {name: dict(zip(names, map(float, row), strict=True)) for name, row in zip(names, matrix, strict=True)}


def pure_voxels(fraction: Real[np.ndarray, "z y x"], full: float = 1.0) -> Bool[np.ndarray, "z y x"]:
    """Voxels whose neighbours at most two away along each axis are all filled by more than 0.999 of `full`."""
    return ndimage.minimum_filter(fraction, size=5, mode="constant", cval=0) > 0.999 * full


@dataclass(frozen=True, eq=False)
class HeldOutView:
    """One view that the fit has not seen.

    Parameters
    ----------
    counts : measured y
    expected : modelled Y
    open_beam : counts without an object; a pixel that counts nothing even then is left out
    away : rays away from edges
    marked : rays through voxels whose bases the counts do not tell; None where there are none
    """

    counts: Real[np.ndarray, "channel row column"]
    expected: Real[np.ndarray, "channel row column"]
    open_beam: Real[np.ndarray, "channel row column"]
    away: Bool[np.ndarray, "row column"]
    marked: Bool[np.ndarray, "row column"] | None = None

    @classmethod
    def of(
        cls,
        counts: Real[np.ndarray, "channel row column"],
        expected: Real[np.ndarray, "channel row column"],
        open_beam: Real[np.ndarray, "channel row column"],
        distance: float = 2.0,
        marked: Bool[np.ndarray, "row column"] | None = None,
    ) -> "HeldOutView":
        """With the rays more than `distance` pixels from the edges that the model's own log projections show."""
        logs = log_projections(expected, open_beam)
        whole = np.stack([inpainted(image, air <= 0) for image, air in zip(logs, open_beam, strict=True)])
        return cls(counts, expected, open_beam, edge_mask(whole, distance), marked)


def score_projections(views: Iterable[HeldOutView], channel_names: Sequence[str]) -> dict[str, Scores]:
    """How well a model predicts views that it has not seen; takes one view at a time.

    Returns
    -------
    By channel: ``psnr`` of the log projections [dB], its peak the largest expected log projection; ``psnr_noise`` what
    the true model would score, from var(log y) = 1 / Y; ``chi_square_all`` mean of (y - Y)^2 / Y over all rays and
    ``chi_square_away`` over rays away from edges, both 1 for Poisson counts of the true model; ``away`` the part of the
    rays that are, ``rays_away`` how many, and ``counts_away`` the mean of what the model expects of them, rays beside
    the object as 0: a relative model error e inside the object adds e^2 times that to ``chi_square_away``. Where rays
    are marked, also ``chi_square_marked``, ``rays_marked`` and ``counts_marked`` of these. In logarithms counts below
    0.5 are taken as 0.5. A channel that sees no photons scores None.
    """
    table = np.array([_sums_of_view(view) for view in views]).reshape(-1, 11, len(channel_names))
    peaks = table[:, -1].max(axis=0, initial=0.0)
    scores = {}
    for name, peak, sums in zip(channel_names, peaks, table[:, :-1].sum(axis=0).T, strict=True):
        rays, rays_away, chi_all, chi_away, square, variance, through, rays_marked, chi_marked, counts_marked = sums
        scores[name] = {
            "psnr": psnr(peak, _ratio(square, rays)),
            "psnr_noise": psnr(peak, _ratio(variance, rays)),
            "chi_square_all": _ratio(chi_all, rays),
            "chi_square_away": _ratio(chi_away, rays_away),
            "away": _ratio(rays_away, rays),
            "rays_away": int(rays_away) or None,
            "counts_away": _ratio(through, rays_away),
        }
        if rays_marked:
            scores[name] |= {
                "chi_square_marked": _ratio(chi_marked, rays_marked),
                "rays_marked": int(rays_marked),
                "counts_marked": _ratio(counts_marked, rays_marked),
            }
    return scores


def psnr(peak: float, mean_square_error: float | None) -> float | None:
    """10 log10(peak^2 / MSE) [dB]; None where there is no peak or no error."""
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
    """Mean over the axial slices that hold truth."""
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
    """-log of counts, at least half a one, over open beam; 0 for a pixel that counts nothing."""
    logged = np.maximum(expected, _FEWEST_LOGGED).astype(np.float64)
    return np.log(np.where(open_beam > 0, open_beam, logged) / logged)


def _sums_of_view(view: HeldOutView) -> np.ndarray:
    """Rays, rays away from edges, chi-square of both, squared log error, its variance, counts; marked; largest log.."""
    seen = view.open_beam > 0
    counts = np.asarray(view.counts, dtype=np.float64)
    expected = np.maximum(np.asarray(view.expected, dtype=np.float64), _FEWEST_EXPECTED)
    logged = np.maximum(expected, _FEWEST_LOGGED)
    projection = log_projections(expected, view.open_beam)
    away = seen & view.away
    chi_square = (counts - expected) ** 2 / expected
    log_error = np.log(np.maximum(counts, _FEWEST_LOGGED) / logged)
    sums = [(w * v).sum(axis=(1, 2)) for w, v in ((seen, 1), (away, 1), (seen, chi_square), (away, chi_square))]
    sums += [(seen * log_error**2).sum(axis=(1, 2)), (seen / logged).sum(axis=(1, 2))]
    sums.append(((away & (projection > SHALLOW)) * expected).sum(axis=(1, 2)))
    marked = np.zeros_like(seen) if view.marked is None else seen & view.marked
    sums += [(marked * v).sum(axis=(1, 2)) for v in (1, chi_square, expected)]
    return np.array([*sums, projection.max(axis=(1, 2))])
