"""The orbit of a scene, a preset or a dataset, drawn in plan."""

from pathlib import Path

from phantomgen.dataset.reader import open_dataset
from phantomgen.display.figures.style import check_picture
from phantomgen.display.viewer.load import is_dataset, scene_of
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.runtime.outputs import check_output
from spectra.errors import InputError


def draw_orbit(source: str | None, preset: str | None, out: Path, overwrite: bool = False) -> None:
    """Draw the nominal geometry as PNG, PDF or SVG.

    Parameters
    ----------
    source : path of a dataset or a scene file, or the name of a preset
    preset : the name of a preset, in place of `source`
    out : the picture
    overwrite : replace a picture that exists
    """
    check_picture(out)
    check_output(out, overwrite, "--geometry")
    geometry, grid = _geometry_of(source, preset)
    geometry.draw(out, grid)


def _geometry_of(source: str | None, preset: str | None) -> tuple[Geometry, Grid]:
    """Nominal geometry and the volume."""
    if source is not None and is_dataset(Path(source)):
        anywhere = (slice(0, 1), slice(0, 1))
        with open_dataset(source, air=anywhere) as dataset:
            if not len(dataset.geometry):
                raise InputError(f"{source} has no views, so there is no scan to show")
            return dataset.geometry, dataset.grid
    from phantomgen.scene.geometry import scene_geometry  # noqa: PLC0415 - datasets need no scenes

    file = scene_of(source, preset)
    geometry = scene_geometry(file)
    return geometry.nominal or geometry.true, file.model.volume.grid
