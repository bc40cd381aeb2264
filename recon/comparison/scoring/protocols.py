"""Protocols of scores for images and volumes: peak, scale and window, on which every score depends.

``honest`` detects a wrong scale and compares with the truth. ``r2`` is what the published code of R2-Gaussian computes,
``paper`` what SpectralCTGaussians, which builds on it, reports: both divide every projection by its own maximum, so
that they do not detect an error of scale, and ``paper`` takes a reconstruction from all views as the truth of channels.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Real

from recon.evaluation.metrics import SSIM_WINDOW, psnr
from recon.published_methods.paper.loss import ssim as slice_ssim
from spectra.errors import InputError

Scores = dict[str, float | None]


@dataclass(frozen=True)
class Protocol:
    """Definition of a protocol.

    Parameters
    ----------
    name : of the protocol
    own_scale : whether a projection and its prediction are each divided by their own maximum, and PSNR is the mean of
        that of the views; else the peak is the largest measured log projection of the channel, and PSNR that of the
        mean square error of all views
    by_slices : whether SSIM of volumes is that of slices along the three axes, with zeros around them; else it is
        three-dimensional
    pseudo_truth : whether volumes of channels are compared with filtered back-projection of all views
    """

    name: str
    own_scale: bool
    by_slices: bool
    pseudo_truth: bool

    def view(
        self, image: Float[np.ndarray, "row column"], measured: Float[np.ndarray, "row column"], peak: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Divide a predicted and a measured projection by the peak of the protocol.

        Parameters
        ----------
        image : predicted log projection [no unit]
        measured : measured log projection [no unit]
        peak : largest measured log projection of the channel

        Returns
        -------
        prediction and measurement
        """
        if not self.own_scale:
            return image / peak, measured / peak
        highest = (float(array.max(initial=0.0)) for array in (image, measured))
        scales = [value if value > 0 else 1.0 for value in highest]
        return image / scales[0], measured / scales[1]

    def volume(self, volume: Real[np.ndarray, "z y x"], truth: Real[np.ndarray, "z y x"]) -> Scores:
        """Score a volume; scores are None for a truth without a positive value.

        Parameters
        ----------
        volume : the result [1/mm]
        truth : on the same grid [1/mm]

        Returns
        -------
        ``psnr`` [dB] with the largest true value as peak, ``psnr_scaled`` after the best scalar, ``psnr_zero`` of a
        volume of zeros, ``ssim``, and ``rmse`` in the unit of the volume, which any truth has
        """
        peak = float(truth.max(initial=0.0))
        volume, truth = (np.asarray(v, np.float64) for v in (volume, truth))
        rmse = float(np.sqrt(_mean_square(volume - truth)))
        if peak <= 0:
            return {**dict.fromkeys(("psnr", "psnr_scaled", "psnr_zero", "ssim")), "rmse": rmse}
        volume, truth = volume / peak, truth / peak
        energy = float(np.vdot(volume, volume))
        scale = float(np.vdot(volume, truth)) / energy if energy > 0 else 0.0
        return {
            "psnr": psnr(1.0, _mean_square(volume - truth)),
            "psnr_scaled": psnr(1.0, _mean_square(scale * volume - truth)),
            "psnr_zero": psnr(1.0, _mean_square(truth)),
            "ssim": ssim_of_slices(volume, truth) if self.by_slices else ssim_3d(volume, truth),
            "rmse": rmse,
        }


PROTOCOLS = {
    p.name: p
    for p in (
        Protocol("honest", own_scale=False, by_slices=False, pseudo_truth=False),
        Protocol("paper", own_scale=True, by_slices=True, pseudo_truth=True),
        Protocol("r2", own_scale=True, by_slices=True, pseudo_truth=False),
    )
}


def protocol_named(name: str) -> Protocol:
    """Return a protocol.

    Parameters
    ----------
    name : of the protocol

    Returns
    -------
    the protocol

    Raises
    ------
    InputError
        When there is none of that name.
    """
    if name not in PROTOCOLS:
        raise InputError(f"there is no metric protocol {name!r}: choose from {', '.join(PROTOCOLS)}")
    return PROTOCOLS[name]


def image_ssim(image: Float[np.ndarray, "row column"], truth: Float[np.ndarray, "row column"]) -> float:
    """Compute the mean structural similarity of images, in the form of R2-Gaussian.

    Parameters
    ----------
    image : prediction
    truth : what it is compared with

    Returns
    -------
    mean for a window of 11 x 11 pixels with sigma 1.5 pixels, zeros outside the image, range 1
    """
    pair = (torch.from_numpy(np.ascontiguousarray(a, np.float64))[None, None] for a in (image, truth))
    return float(slice_ssim(*pair).mean())


def ssim_3d(volume: Float[np.ndarray, "z y x"], truth: Float[np.ndarray, "z y x"]) -> float | None:
    """Compute the mean structural similarity of volumes with a window in three dimensions.

    Parameters
    ----------
    volume : the result
    truth : what it is compared with

    Returns
    -------
    mean for a Gaussian window of sigma 1.5 voxels, range 1; None where a volume is narrower than the window
    """
    from skimage.metrics import structural_similarity  # noqa: PLC0415 - a third of a second

    if min(truth.shape) < SSIM_WINDOW:
        return None
    options = {"data_range": 1.0, "gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    return float(structural_similarity(volume, truth, **options))  # type: ignore[arg-type] - it may be a pair


def ssim_of_slices(volume: Float[np.ndarray, "z y x"], truth: Float[np.ndarray, "z y x"]) -> float:
    """Compute the mean structural similarity of slices, in the form of R2-Gaussian.

    Parameters
    ----------
    volume : the result
    truth : what it is compared with

    Returns
    -------
    mean of `image_ssim` over the slices along an axis that hold truth, then over the three axes
    """
    means = []
    for axis in range(3):
        stacks = [torch.from_numpy(np.ascontiguousarray(np.moveaxis(v, axis, 0))) for v in (volume, truth)]
        holds = (stacks[1] > 0).any(dim=(1, 2))
        images = [stack[holds][:, None] for stack in stacks]
        means.append(float(slice_ssim(*images).mean()))
    return float(np.mean(means))


def _mean_square(values: np.ndarray) -> float:
    return float(np.mean(np.square(values)))
