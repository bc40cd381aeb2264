"""Pickles for NAF and SAX-NeRF, one per channel: lengths in mm, attenuation in 1/m, as their readers take them."""

import pickle
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name, fill
from phantomgen.exporters.scans.learned.r2_gaussian import true_volume
from phantomgen.geometry.conversions.naf import to_naf

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
data = TIGREDataset(f"{scan['files'][name]}.pickle", type="train", device="cuda")
print(len(data), "views to train, rays", tuple(data.rays.shape), "volume", tuple(data.image.shape))
"""
IMPORTS = "from src.dataset.tigre import TIGREDataset  # run with NAF's folder in PYTHONPATH"
_PER_M = np.float32(1000.0)


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write one pickle per channel.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know: nothing
    """
    keys, angles = to_naf(projections.geometry, projections.grid)
    panel, train, views = projections.geometry.panel, projections.train, len(projections)
    keys |= {"numTrain": train, "numVal": views - train, "randomAngle": False, "normalize": False, "convert": False}
    stacks = [np.empty((views, panel.rows, panel.columns), np.float32) for _ in projections.names]
    fill(projections, stacks)
    for number, (name, images) in enumerate(zip(projections.names, stacks, strict=True)):
        parts = {"train": slice(None, train), "val": slice(train, None)}
        content = keys | {key: {"projections": images[part], "angles": angles[part]} for key, part in parts.items()}
        content["image"] = true_volume(projections, number).transpose(2, 1, 0) * _PER_M
        with (folder / f"{file_name(name)}.pickle").open("wb") as file:
            pickle.dump(content, file, protocol=4)
    return {"truth": projections.volumes is not None}
