"""What makes an operator of Gaussians that runs on the CPU differentiable by torch."""

from collections.abc import Callable, Iterable
from importlib.util import find_spec
from typing import Protocol, TypeVar, runtime_checkable

import numpy as np
import torch
from torch import Tensor

Kind = TypeVar("Kind", bound=tuple[Tensor, ...])


@runtime_checkable
class OperatorCall(Protocol):
    """One call of an operator, with the arrays that its values and its gradients share."""

    def values(self) -> np.ndarray:
        """Compute the values of the operator.

        Returns
        -------
        values, float32
        """
        ...

    def gradients(self, cotangent: Tensor) -> Iterable[np.ndarray]:
        """Compute gradients in the tensors of the Gaussians.

        Parameters
        ----------
        cotangent : gradient in the values

        Returns
        -------
        one gradient per tensor, in their order
        """
        ...


def apply_on_cpu(prepare: Callable[[Kind], OperatorCall], gaussians: Kind) -> Tensor:
    """Apply an operator to Gaussians; differentiable once in the tensors of the Gaussians.

    Parameters
    ----------
    prepare : makes the call for given Gaussians
    gaussians : a named tuple of tensors, coefficients last; may lie on any device

    Returns
    -------
    values on the device of the Gaussians, with the type of their coefficients
    """
    return _OnCpu.apply(prepare, type(gaussians), *gaussians)  # type: ignore[return-value]


def on_gpu(tensor: Tensor) -> bool:
    """Whether kernels of Triton compute what belongs to a tensor: it is on a GPU, and Triton is installed.

    Parameters
    ----------
    tensor : any tensor

    Returns
    -------
    whether it is
    """
    return tensor.device.type == "cuda" and find_spec("triton") is not None


class _OnCpu(torch.autograd.Function):
    @staticmethod
    def forward(ctx, prepare, kind, *parts):
        ctx.call, ctx.dtypes, ctx.device = prepare(kind(*parts)), [x.dtype for x in parts], parts[0].device
        return torch.from_numpy(ctx.call.values()).to(device=ctx.device, dtype=parts[-1].dtype)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, *cotangents):
        gradients = zip(ctx.call.gradients(cotangents[0]), ctx.dtypes, strict=True)
        return None, None, *(torch.from_numpy(g).to(device=ctx.device, dtype=dtype) for g, dtype in gradients)
