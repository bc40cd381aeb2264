"""Several processes at one fit: each takes a share of the views of every step, and gradients are summed.

`torchrun` starts the processes and tells each its number by environment variables. Sums travel by gloo between
processors and by NCCL between GPUs. All processes hold the same model and make the same steps; the first one writes.
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

from spectra.errors import InputError

T = TypeVar("T")
PATIENCE = timedelta(hours=12)  # how long a process waits for the others, as the first one makes the start alone


@dataclass(frozen=True)
class Processes:
    """Which process this is, and of how many.

    Parameters
    ----------
    rank : number of this process, from 0
    count : number of processes
    """

    rank: int = 0
    count: int = 1

    @property
    def first(self) -> bool:
        """Whether this is the one that writes."""
        return self.rank == 0

    def share(self, views: Int[np.ndarray, " view"]) -> Int[np.ndarray, " view"]:
        """Those of the views that this process takes; none where there are fewer views than processes."""
        return views[self.rank :: self.count]

    def add_up(self, tensors: Sequence[Tensor]) -> None:
        """Replace tensors of one type by their sums over all processes, in one message."""
        if self.count == 1:
            return
        flat = torch.cat([tensor.reshape(-1) for tensor in tensors])
        torch.distributed.all_reduce(flat)
        for tensor, total in zip(tensors, flat.split([tensor.numel() for tensor in tensors]), strict=True):
            tensor.copy_(total.view_as(tensor))

    def any(self, flag: bool) -> bool:
        """Whether the flag is set in some process."""
        if self.count == 1:
            return flag
        total = torch.tensor([float(flag)])
        torch.distributed.all_reduce(total)
        return bool(total.item() > 0)

    def from_first(self, value: T) -> T:
        """What the first process holds; the values of the others do not matter."""
        if self.count == 1:
            return value
        box = [value]
        torch.distributed.broadcast_object_list(box, src=0)
        return box[0]


ALONE = Processes()


@contextmanager
def joined() -> Iterator[Processes]:
    """The processes that `torchrun` started, connected for as long as the context lasts; `ALONE` without it.

    Raises
    ------
    InputError
        When what `torchrun` says makes no sense.
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
    torch.distributed.init_process_group(backend, timeout=PATIENCE)
    try:
        yield Processes(int(rank), int(count))
    finally:
        torch.distributed.destroy_process_group()
