"""Check of a voxel or view method before a run: its pipeline, its curve of materials, and the orbit of the scan."""

from phantomgen.dataset.reader import Dataset
from recon.runs.methods import NEED_CURVE, ONE_CHANNEL
from recon.voxel.filtered.circular_orbit import circular_orbit_of
from recon.voxel.filtered.fdk import Fdk
from recon.voxel.initial_volumes import check_directions
from recon.voxel.method import CountsMethod, Method, ViewMethod
from spectra.errors import InputError

PIPELINES = ("two-step", "image")


def check_method(method: Method | ViewMethod, pipeline: str, dataset: Dataset) -> None:
    """Refuse a method that lacks the pipeline, or that cannot reconstruct the orbit.

    Parameters
    ----------
    method : voxel or view method
    pipeline : one of `PIPELINES`
    dataset : open dataset, of which counts are not read

    Raises
    ------
    InputError
        When the method has no such pipeline.
    GeometryError
        When all training views have the same direction, or the orbit is not one that filtered back-projection can
        reconstruct.
    """
    if isinstance(method, CountsMethod) and pipeline != PIPELINES[0]:
        raise InputError(f"the method {method.name} works on counts: leave --pipeline {pipeline} out")
    if isinstance(method, ViewMethod) and pipeline != PIPELINES[0]:
        raise InputError(f"the method {method.name} has no volume: leave --pipeline {pipeline} out")
    train = dataset.geometry[dataset.splits["train"]]
    check_directions(train)
    if isinstance(method, Fdk):
        circular_orbit_of(train, dataset.grid)


def check_curve(method: Method, on_curve: bool, dataset: Dataset) -> None:
    """Refuse a curve of materials for a method that takes none, and methods of one channel without one.

    Parameters
    ----------
    method : voxel method
    on_curve : whether a curve is asked for
    dataset : open dataset, of which counts are not read

    Raises
    ------
    InputError
        When the method takes no curve, or needs one, or the scan has more channels than it takes.
    GeometryError
        When the orbit is not one that filtered back-projection can reconstruct.
    """
    if on_curve and not hasattr(method, "curve"):
        raise InputError(f"the method {method.name} takes no curve of materials: take --method one-step")
    if method.name in NEED_CURVE and not on_curve:
        raise InputError(f"the method {method.name} needs a curve of materials: add --bases curve")
    if method.name in ONE_CHANNEL:
        if (channels := len(dataset.spectra.channels)) > 1:
            raise InputError(f"the method {method.name} takes one channel, and {dataset.path} has {channels}")
        circular_orbit_of(dataset.geometry[dataset.splits["train"]], dataset.grid)
