"""True poses of a scan, which only the score reads."""

from pathlib import Path

import h5py
import numpy as np
from jaxtyping import Float

from phantomgen.dataset.checks.door import group_at, has, value_at
from phantomgen.dataset.file import damaged_file, open_file
from phantomgen.dataset.geometry import read_geometry, write_geometry
from phantomgen.dataset.layout import new_group, put
from phantomgen.dataset.reader import open_dataset
from phantomgen.geometry.poses import Geometry
from spectra.errors import DatasetError


def write_true_geometry(truth: h5py.Group, geometry: Geometry, sample: Float[np.ndarray, "view 4 4"] | None) -> None:
    """Write the poses that were simulated, in the frame of the sample, and where the sample was.

    Parameters
    ----------
    truth : group of the truth
    geometry : true poses
    sample : matrices from the sample at rest to where it was [mm], None where it did not move
    """
    write_geometry(truth, geometry)
    if sample is not None:
        put(new_group(truth, "motion", "NXcollection"), "pose", sample, "mm")


def read_true_geometry(path: Path | str) -> Geometry | None:
    """Read the true poses of a dataset.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    the poses; None where they equal those of ``/entry/geometry``

    Raises
    ------
    DatasetError
        When the file is damaged, or the numbers of views differ.
    """
    anywhere = (slice(0, 1), slice(0, 1))
    with open_dataset(path, air=anywhere) as dataset, damaged_file(dataset.path):
        if not has(dataset.file, "truth/geometry"):
            return None
        nominal = dataset.geometry
        true = read_geometry(group_at(dataset.file, "truth/geometry"), nominal.panel, nominal.angles)
        if len(true) != len(nominal):
            raise DatasetError(f"{path}: /truth/geometry has {len(true)} views, /entry/geometry {len(nominal)}")
        return true


def read_sample_poses(path: Path | str) -> Float[np.ndarray, "view 4 4"] | None:
    """Read the pose of the sample in each view, as matrices from its rest to there.

    Parameters
    ----------
    path : the dataset

    Returns
    -------
    matrices [mm], (view, 4, 4); None where the sample did not move
    """
    with open_file(Path(path), "truth") as file, damaged_file(Path(path)):
        return value_at(file, "truth/motion/pose") if has(file, "truth/motion/pose") else None
