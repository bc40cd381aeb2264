"""Pixels that do not measure, as a dataset stores them: the field ``pixel_mask`` of each NXdetector_channel."""

import h5py
import numpy as np
from jaxtyping import Bool, UInt32

from phantomgen.dataset.checks.door import find_array, group_at
from spectra.errors import DatasetError

_DETECTOR = "/entry/instrument/detector"
_REJECTING = 0x0000FFFF  # bits that reject a pixel; those above only say something about it (NXdetector)


def write_mask(file: h5py.File, channels: tuple[str, ...], mask: UInt32[np.ndarray, "row column"] | None) -> None:
    """Write the same mask for every channel; nothing where there is none.

    Parameters
    ----------
    file : open dataset
    channels : names of the channels
    mask : bits of each pixel; None for no mask
    """
    if mask is None:
        return
    for name in channels:
        group = group_at(file, f"{_DETECTOR}/{name}_channel")
        group.create_dataset("pixel_mask", data=mask, compression="gzip", shuffle=True, fletcher32=True)


def mask_of(file: h5py.File, channel: str) -> h5py.Dataset | None:
    """Return the stored mask of a channel.

    Parameters
    ----------
    file : open dataset
    channel : name of the channel

    Returns
    -------
    the array; None where the channel has none
    """
    return find_array(file, f"{_DETECTOR}/{channel}_channel/pixel_mask")


def read_mask(
    file: h5py.File, channels: tuple[str, ...], pixels: tuple[int, int]
) -> Bool[np.ndarray, "channel row column"]:
    """Read the pixels of each channel that must not be used.

    Parameters
    ----------
    file : open dataset
    channels : names of the channels
    pixels : rows and columns of the panel

    Returns
    -------
    True for these pixels, (channel, row, column)

    Raises
    ------
    DatasetError
        When a mask leaves nothing of a channel.
    """
    masks = np.zeros((len(channels), *pixels), bool)
    for mask, name in zip(masks, channels, strict=True):
        stored = mask_of(file, name)
        if stored is None:
            continue
        mask[:] = stored[()].astype(np.int64) & _REJECTING != 0
        if mask.all():
            raise DatasetError(f"{file.filename}: {stored.name} leaves no pixel that measures")
    return masks
