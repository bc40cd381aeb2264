"""Folders for R2-Gaussian, one per channel, in lengths of half the volume's largest side, as its settings expect."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name
from phantomgen.geometry.conversions.r2_gaussian import to_r2_gaussian

KINDS: tuple[Kind, ...] = ("line-integrals",)
SCRIPT = """
scan, name = load()
scene = readBlenderInfo(scan["files"][name], eval=True)  # run from R2-Gaussian's folder, by its full name
print(len(scene.train_cameras), "views to train,", len(scene.test_cameras), "to test, volume", tuple(scene.vol.shape))
print("python initialize_pcd.py --data", scan["files"][name], "&& python train.py -s", scan["files"][name])
"""
IMPORTS = "from r2_gaussian.dataset.dataset_readers import readBlenderInfo"
_LENGTHS = ("DSD", "DSO", "sDetector", "sVoxel", "offOrigin", "offDetector")


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write one folder per channel.

    Parameters
    ----------
    folder : that gets the folders
    projections : what to write

    Returns
    -------
    what the script needs to know: nothing
    """
    scanner, angles = to_r2_gaussian(projections.geometry, projections.grid)
    unit = max(scanner["sVoxel"]) / 2  # mm; attenuation is in 1/unit, line integrals have none
    scanner |= {name: (np.array(scanner[name]) / unit).tolist() for name in _LENGTHS}
    scanner["unit_mm"] = unit
    lists = [[], []]  # training, test
    for view in range(len(projections)):
        part = int(view >= projections.train)
        path = f"proj_{('train', 'test')[part]}/proj_{('train', 'test')[part]}_{len(lists[part]):04d}.npy"
        lists[part].append({"file_path": path, "angle": float(angles[view])})
    places = [entry["file_path"] for part in lists for entry in part]
    box = (np.array(scanner["sVoxel"]) / 2)[None] * [[-1], [1]] + np.array(scanner["offOrigin"])
    meta = {
        "scanner": scanner, "vol": "vol_gt.npy", "bbox": box.tolist(), "proj_train": lists[0], "proj_test": lists[1],
    }  # fmt: skip
    own = [folder / file_name(name) for name in projections.names]
    for place in own:
        (place / "proj_train").mkdir(parents=True)
        (place / "proj_test").mkdir()
        (place / "meta_data.json").write_text(json.dumps(meta, indent=1), encoding="utf-8")
    for view, path in enumerate(places):
        for place, image in zip(own, projections.image(view), strict=True):
            np.save(place / path, image.astype(np.float32))
    for number, place in enumerate(own):
        np.save(place / "vol_gt.npy", true_volume(projections, number).transpose(2, 1, 0) * np.float32(unit))
    return {"unit_mm": unit, "truth": projections.volumes is not None}


def true_volume(projections: Projections, number: int) -> np.ndarray:
    """Return the true volume that these formats must hold, for scores; zeros where the truth is not known.

    Parameters
    ----------
    projections : of the scan
    number : of the channel

    Returns
    -------
    attenuation (z, y, x) [1/mm]
    """
    if projections.volumes is None:
        return np.zeros(projections.grid.shape, np.float32)
    return projections.volumes(number).astype(np.float32)
