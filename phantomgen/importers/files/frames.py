"""Open-beam frames and frames without beam from files of their own: TIFF stacks, or one NumPy array."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from phantomgen.importers.files.images import tiff_stack
from phantomgen.runtime.numpy_files import load_numpy
from spectra.errors import InputError


def read_frames(paths: Sequence[Path]) -> Shaped[np.ndarray, "frame channel row column"]:
    """Read frames of all channels.

    Parameters
    ----------
    paths : TIFF files, one per channel in the order of the channels; or one ``.npy`` with the axes (frame, channel,
        row, column)

    Returns
    -------
    the frames

    Raises
    ------
    InputError
        When a file is missing or damaged, or the channels have different numbers of frames.
    """
    if any(path.suffix.lower() == ".npy" for path in paths):
        if len(paths) > 1:
            raise InputError(f"frames are one .npy or a TIFF stack per channel, got {len(paths)} files with {paths[0]}")
        try:
            frames = load_numpy(paths[0])
        except (OSError, ValueError) as error:
            raise InputError(f"{paths[0]} cannot be read: {error}") from None
        if frames.ndim != 4 or frames.dtype.kind not in "iuf":
            raise InputError(
                f"{paths[0]} holds {frames.dtype} of shape {frames.shape}, expected (frame, channel, row, column)"
            )
        return frames
    stacks = [tiff_stack([path]) for path in paths]
    for path, stack in zip(paths, stacks, strict=True):
        if (len(stack), stack.shape) != (len(stacks[0]), stacks[0].shape):
            raise InputError(
                f"{path} has {len(stack)} frames of {stack.shape} pixels, {paths[0].name} {len(stacks[0])} of "
                f"{stacks[0].shape}: channels need as many frames of the same shape"
            )
    return np.stack([stack.all() for stack in stacks], axis=1)
