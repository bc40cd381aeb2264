"""What a fit computes with: processes that share its views, a device, and a place for large arrays.

`torchrun` starts the processes and gives each its number in environment variables. Each takes a part of the views of
every step, and gradients are summed, by gloo between processors and by NCCL between GPUs. All processes hold the same
model and make the same steps; the first one writes.
"""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import TypeVar

import numpy as np
import torch
import torch.distributed.nn.functional  # now: its default arguments hold on to a group that is there on import
from jaxtyping import Int
from torch import Tensor

from recon.data.array_store import IN_MEMORY, ArrayStore
from spectra.errors import InputError

T = TypeVar("T")
WAIT = timedelta(hours=12)  # longest wait of a process for the others; the first one makes the start alone


@dataclass(frozen=True)
class Processes:
    """The number of this process and how many there are.

    Parameters
    ----------
    rank : number of this process, from 0
    count : number of processes
    """

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this process is the one that writes."""
        return self.rank == 0

    def share(self, views: Int[np.ndarray, " view"]) -> Int[np.ndarray, " view"]:
        """Select the views that this process takes.

        Parameters
        ----------
        views : indices of the views of a step

        Returns
        -------
        indices; none where there are fewer views than processes
        """
        return views[self.rank :: self.count]

    def add_up(self, tensors: Sequence[Tensor]) -> None:
        """Replace tensors by their sums over all processes, in one message.

        Parameters
        ----------
        tensors : tensors of one type, changed in place
        """
        if self.count == 1:
            return
        flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
        torch.distributed.all_reduce(flat)
        for tensor, total in zip(tensors, flat.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(total.view_as(tensor))

    def any(self, flag: bool) -> bool:
        """Tell whether a flag is set in any process.

        Parameters
        ----------
        flag : that of this process

        Returns
        -------
        True where one process or more has it set
        """
        if self.count == 1:
            return flag
        total = torch.tensor([float(flag)])
        torch.distributed.all_reduce(total)
        return bool(total.item() > 0)

    def from_first(self, value: T) -> T:
        """Send a value of the first process to all others.

        Parameters
        ----------
        value : anything that pickle takes; that of other processes is not read

        Returns
        -------
        the value of the first process
        """
        if self.count == 1:
            return value
        box = [value]
        torch.distributed.broadcast_object_list(box, src=0)
        return box[0]


ALONE = Processes()


@dataclass(frozen=True)
class Resources:
    """Processes, arrays and device of a fit; its result depends on them by rounding alone.

    Parameters
    ----------
    processes : those that share the views of each step; all are given the same arguments
    store : where counts, line integrals and statistical weights are kept
    device : where Gaussians and the voxels of their start are computed, ``cpu`` or ``cuda``
    """

    processes: Processes = ALONE
    store: ArrayStore = IN_MEMORY
    device: str = "cpu"


LOCAL = Resources()


@contextmanager
def joined() -> Iterator[Processes]:
    """Connect the processes that `torchrun` started for as long as the context lasts.

    Yields
    ------
    this process; `ALONE` without `torchrun`

    Raises
    ------
    InputError
        When the environment variables RANK and WORLD_SIZE contradict each other.
    """
    count = os.environ.get("WORLD_SIZE", "1")
    rank = os.environ.get("RANK", "0")
    if not (count.isdigit() and rank.isdigit() and int(rank) < int(count)):
        raise InputError(f"RANK {rank!r} of WORLD_SIZE {count!r} is no process: start several of them by torchrun")
    if int(count) == 1:
        yield ALONE
        return
    backend = "gloo"
    if torch.cuda.is_available() and torch.distributed.is_nccl_available():
        backend = "cpu:gloo,cuda:nccl"
        torch.cuda.set_device(int(os.environ.get("LOCAL_RANK", "0")) % torch.cuda.device_count())
    torch.distributed.init_process_group(backend, timeout=WAIT)
    try:
        yield Processes(int(rank), int(count))
    finally:
        torch.distributed.destroy_process_group()
