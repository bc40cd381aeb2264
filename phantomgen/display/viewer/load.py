"""Loading of the viewer's content from a scene, a preset or a dataset."""

from pathlib import Path

import h5py

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from phantomgen.dataset.writing.writer import SUFFIXES
from phantomgen.display.viewer.content import Content, Triple, limits
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.file.find_scene import find_scene
from phantomgen.scene.file.scene_file import SceneFile
from spectra.errors import InputError


def load(source: str | None, preset: str | None, at: Triple | None = None, voxels: int | None = None) -> Content:
    """Load the viewer's content of a dataset, of a preset, or of a scene file.

    Parameters
    ----------
    source : path of a dataset or a scene file, or the name of a preset
    preset : the name of a preset, in place of `source`
    at : where the slices cut (x, y, z) [mm], by default the centre
    voxels : along each edge of the volume, in place of those of the scene

    Returns
    -------
    the content

    Raises
    ------
    InputError
        When `voxels` is given for a dataset.
    """
    if source is not None and is_dataset(Path(source)):
        if voxels is not None:
            raise InputError(f"--voxels is for scenes: the truth in {source} has its voxels already")
        return content_of_dataset(Path(source), at)
    return content_of_scene(scene_of(source, preset, [] if voxels is None else [f"volume.voxels={voxels}"]), at)


def scene_of(source: str | None, preset: str | None, overrides: list[str] | None = None) -> SceneFile:
    """Return the scene of a file or a preset; the name of a preset may stand for a file.

    Parameters
    ----------
    source : scene file, or name of a preset
    preset : name of a preset, in place of `source`
    overrides : ``path=value`` with dotted paths

    Returns
    -------
    the scene file
    """
    return SceneFile.preset(preset, overrides or []) if preset else find_scene(source or "", overrides or [])


def content_of_dataset(path: Path, at: Triple | None = None) -> Content:
    """Read the truth and the geometry of a dataset.

    Parameters
    ----------
    path : the dataset
    at : point in the slices (x, y, z) [mm]; the centre where left out

    Returns
    -------
    the content

    Raises
    ------
    InputError
        When the dataset has no views.
    """
    anywhere = (slice(0, 1), slice(0, 1))  # a file without flats can be looked at, too
    with open_dataset(path, air=anywhere) as dataset:
        truth, name, geometry, grid = read_truth(path), dataset.name, dataset.geometry, dataset.grid
    if not len(geometry):
        raise InputError(f"{path} has no views, so there is no scan to show")
    grid = truth.grid if truth else grid
    return Content(name, geometry, grid, truth, at or _centre(grid))


def content_of_scene(file: SceneFile, at: Triple | None = None) -> Content:
    """Voxelize a scene as its dataset will contain it.

    Parameters
    ----------
    file : the scene file
    at : point in the slices (x, y, z) [mm]; the centre where left out

    Returns
    -------
    the content
    """
    from phantomgen.scene.scan import load_scene  # noqa: PLC0415 - what makes voxels is slow to import
    from phantomgen.simulation.forward_model.truth import scan_truth  # noqa: PLC0415

    scan = load_scene(file)
    at = at or _centre(scan.grid)
    geometry = scan.nominal or scan.geometry
    Content(scan.name, geometry, scan.grid, None, at)  # refuses a bad point before the voxels are made
    return Content(scan.name, geometry, scan.grid, scan_truth(scan), at)


def is_dataset(path: Path) -> bool:
    """Return whether a file is HDF5, or should be by its name.

    Parameters
    ----------
    path : the file

    Returns
    -------
    True for HDF5
    """
    return path.suffix.lower() in SUFFIXES or (path.is_file() and h5py.is_hdf5(path))


def _centre(grid: Grid) -> Triple:
    """Centre of a volume [mm]."""
    low, high = limits(grid)
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    return x, y, z
