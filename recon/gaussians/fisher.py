"""Information of the rays about the coefficients: Fisher matrices of line integrals, and the curvature from them."""

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from recon.data.measurements import Measurements
from recon.gaussians.model import GaussianModel
from spectra.differentiable import transmit_and_jacobian

VIEWS_AT_ONCE = 5  # views; images of so many are held in memory together; chosen by hand, not measured


def coefficient_curvature(
    gaussians: GaussianModel, measurements: Measurements, dispersion: float
) -> Float[Tensor, "gaussian *side basis basis"]:
    """Compute a separable majoriser of the data term's curvature in the coefficients, with the geometry held.

    Parameters
    ----------
    gaussians : the model
    measurements : views to sum over
    dispersion : relative model error eta [no unit]

    Returns
    -------
    one block H_i per Gaussian [mm^2]

    Notes
    -----
    With a_ri the line integral of Gaussian i along ray r for coefficient 1 [mm] and F_r the Fisher matrix of the ray's
    line integrals, H_i = sum_r a_ri (sum_j a_rj) F_r. Steps by the inverse of H_i lower the data term and do not depend
    on the choice of basis functions.

    References
    ----------
    Separable quadratic surrogates: Weidinger et al. 2016, doi:10.1155/2016/5871604; Mechlem et al. 2018,
    doi:10.1109/TMI.2017.2726687.
    """
    bases = gaussians.coefficients.shape[-1]
    upper = np.triu_indices(bases)
    values = gaussians.coefficients.new_zeros(*gaussians.coefficients.shape[:-1], max(bases + 1, len(upper[0])))
    values[..., :bases], values[..., bases] = gaussians.coefficients.detach(), 1
    values.requires_grad_()
    sums = torch.zeros_like(values)
    for first in range(0, len(measurements), VIEWS_AT_ONCE):
        some = measurements[slice(first, first + VIEWS_AT_ONCE)]
        images = gaussians.with_values(values).line_integrals(some.geometry)
        # The operator is linear in `values`, so its adjoint may be applied to images other than those it made.
        ray_gradients = torch.zeros_like(images)
        for view in range(len(some)):  # matrices of one view at a time, in float64
            line_integrals = images[[view], :bases].detach().clamp(min=0)
            if images.device.type == "cpu":
                matrices = torch.from_numpy(ray_information(some[[view]], line_integrals.numpy(), dispersion))
            else:
                matrices = ray_information_on_device(some[[view]], line_integrals, dispersion)
            information = matrices[0][:, :, *upper].movedim(-1, 0)
            ray_gradients[view, : len(upper[0])] = information.to(ray_gradients)
        ray_gradients *= images[:, bases : bases + 1].detach()
        sums += torch.autograd.grad(images, values, ray_gradients)[0]
    sums = sums[..., : len(upper[0])]
    blocks = sums.new_empty(*sums.shape[:-1], bases, bases)
    blocks[..., upper[0], upper[1]] = sums
    blocks[..., upper[1], upper[0]] = sums
    return blocks


def ray_information(
    measurements: Measurements, line_integrals: Float[np.ndarray, "view basis row column"], dispersion: float
) -> Float[np.ndarray, "view row column basis basis"]:
    """Compute the Fisher matrix of every ray's line integrals.

    Parameters
    ----------
    measurements : views with as many bases as `line_integrals`
    line_integrals : where the matrices are evaluated, (V, M, R, K) [no unit]
    dispersion : relative model error eta [no unit]

    Returns
    -------
    J^T diag(s / (Y + (eta Y)^2)) J, with Y the expected counts, J their derivatives and s the statistical weights of
    the measurements, 1 where they have none
    """
    transmission = measurements.transmission
    gains = np.moveaxis(measurements.gains, 0, -1) * measurements.exposure[:, None, None, :]
    lengths = measurements.with_profile(np.moveaxis(line_integrals, 1, -1))
    expected, jacobian = transmission.expected_and_jacobian(lengths)
    expected, jacobian = expected * gains, jacobian[..., : len(measurements.basis_names)] * gains[..., None]
    precision = 1 / np.maximum(expected * (1 + dispersion**2 * expected), np.finfo(float).tiny)
    if measurements.statistical_weights is not None:
        precision = precision * np.moveaxis(measurements.whole_weights, 1, -1)
    return np.einsum("...c,...cm,...cn->...mn", precision, jacobian, jacobian, optimize=True)


def ray_information_on_device(
    measurements: Measurements, line_integrals: Float[Tensor, "view basis row column"], dispersion: float
) -> Float[Tensor, "view row column basis basis"]:
    """Compute the matrices of `ray_information` on the device of the line integrals, in float64.

    Parameters
    ----------
    measurements, line_integrals, dispersion : as in `ray_information`

    Returns
    -------
    matrices as `ray_information` returns
    """
    device, exact, data = line_integrals.device, torch.float64, measurements
    lengths = line_integrals.movedim(1, -1).to(exact)
    if data.profile is not None:
        known = torch.from_numpy(data.profile).to(device, exact).movedim(0, -1)
        lengths = torch.cat([lengths, known.expand(len(lengths), *known.shape)], dim=-1)
    expected, jacobian = transmit_and_jacobian(lengths, data.transmission)
    gains, exposure = (torch.from_numpy(part).to(device, exact) for part in (data.gains, data.exposure))
    gains = gains.movedim(0, -1) * exposure[:, None, None]
    expected, jacobian = expected * gains, jacobian[..., : len(data.basis_names)] * gains[..., None]
    precision = 1 / (expected * (1 + dispersion**2 * expected)).clamp(min=torch.finfo(exact).tiny)
    if data.statistical_weights is not None:
        precision = precision * torch.from_numpy(data.whole_weights).to(device).movedim(1, -1)
    return (jacobian * precision[..., None]).mT @ jacobian
