"""Check of a voxel or view method before a run: its pipeline, and the orbit of the scan."""

from phantomgen.dataset.reader import Dataset
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
