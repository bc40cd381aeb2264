"""The commands ``recon volume`` and ``recon render``: a fitted model on other grids, at energies, from other views."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import FiniteRange, Printing, debug_option, grouped, json_option, progress_options
from recon.cli.common import refuse_options
from recon.cli.run_argument import RunFolder

_RUN = RunFolder()
_FILE = click.Path(dir_okay=False, path_type=Path)
_SUFFIXES = (".h5", ".hdf5")
_POSITIVE = FiniteRange(min=0, min_open=True)


def _common(command: Callable) -> Callable:
    """Options that both commands have."""
    options = (
        click.option("--overwrite", is_flag=True, help="Replace a file that exists."),
        click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all]."),
        progress_options,
        json_option,
        debug_option,
    )
    for option in reversed(options):
        command = option(command)
    return command


@dataclass(frozen=True)
class _Shown:
    """What is written: basis volumes, or a quantity."""

    what: str | None
    deviation: bool
    energy: float | None
    water: str | None
    materials: tuple[str, ...]


@dataclass(frozen=True)
class _Place:
    """The voxels."""

    grid: str | None
    voxel: float | None
    size: str | None
    center: str | None
    like: Path | None


@dataclass(frozen=True)
class _Output:
    """The file that is written."""

    out: Path | None
    overwrite: bool


@click.command(
    epilog="\b\nQuantities:\n"
    "  vmi               attenuation at --energy [1/mm]\n"
    "  hu                CT numbers at --energy [HU]\n"
    "  vnc               CT numbers at --energy without contrast agents [HU]\n"
    "  iodine, Gd, ...   concentration of an element that a basis function shows [mg/ml]\n"
    "  electron-density  over that of water, without contrast agents\n"
    "  zeff              effective atomic number, without contrast agents\n"
    "  fractions         volume fractions of the materials that --material names, a map for each\n\n"
    "\b\nExamples:\n  recon volume kedge-run --voxel 0.5 --size 160 -o fine.h5\n"
    "  recon volume kedge-run --as hu --energy 60 -o hu60.nii.gz\n"
    "  recon volume vials-run --as iodine -o iodine.vti\n"
    "  recon volume vials-run --as vnc -o vnc-dicom\n"
    "  recon volume run --as fractions --material adipose --material water --material hydroxyapatite:2.9\n"
    "  recon volume vials-run --as iodine --deviation -o sd.nii.gz"
)
@click.argument("run", type=_RUN)
@click.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    help="File: .h5, .nii, .nii.gz or .vti; without suffix the folder of a DICOM series [default: <run>-volume.h5].",
)
@click.option(
    "--as",
    "what",
    metavar="QUANTITY",
    help="In place of basis volumes: vmi, hu, vnc, electron-density, zeff, fractions, or an element such as iodine.",
)
@click.option("--deviation", is_flag=True, help="In place of the quantity its standard deviation, on the grid of RUN.")
@click.option("--grid", metavar="N|Z,Y,X", help="Number of voxels along each axis.")
@click.option("--voxel", type=_POSITIVE, metavar="MM", help="Edge of a voxel [default: as in the scan].")
@click.option("--size", metavar="MM|Z,Y,X", help="Size of the volume, in place of --grid.")
@click.option("--center", metavar="Z,Y,X", help="Centre of the volume in mm [default: the isocentre].")
@click.option("--like", type=_FILE, metavar="DATASET", help="Take the grid of a dataset.")
@click.option("--energy", type=FiniteRange(), metavar="KEV", help="Energy of vmi (implied), hu and vnc [default: 70].")
@click.option(
    "--water",
    metavar="basis|table|1/MM",
    help="What 0 HU is: water as the basis describes it, of tables, or its attenuation [default: basis].",
)
@click.option(
    "--material",
    "materials",
    metavar="NAME[:G/CM^3]",
    multiple=True,
    help="A material of fractions: a named material, an element or a formula, where needed with a density; repeatable.",
)
@_common
@grouped(shown=_Shown, place=_Place, output=_Output, printing=Printing)
def volume(
    run: Path,
    output: _Output,
    shown: _Shown,
    place: _Place,
    threads: int | None,
    printing: Printing,
) -> None:
    """Write the basis volumes of RUN, or a quantity that follows from them, on any grid.

    Without options for a grid it is that of the scan. HDF5 files are like volumes.h5 and are written slab by slab. An
    energy outside of the detected spectrum gets a warning. Standard deviations follow from the replicates that `recon
    uncertainty` made.
    """
    from recon.output.volume_file import checked_target, chosen_grid, deviation_of, write_volume
    from recon.readouts.fractions import named_materials
    from recon.readouts.quantity import CT_NUMBERS, FRACTIONS, quantity
    from recon.readouts.readouts import Readouts
    from recon.readouts.spectrum import detected_spectrum
    from recon.runs.read_run import open_model
    from spectra.errors import InputError
    from spectra.threads import set_threads

    asked = shown.what or (None if shown.energy is None else "vmi")
    if shown.deviation:
        _check_deviation(
            run,
            asked,
            {"grid": place.grid, "voxel": place.voxel, "size": place.size, "center": place.center, "like": place.like},
        )
    if asked is None and shown.water is not None:
        raise InputError("--water is for CT numbers: add --as hu or --as vnc")
    if asked is None and shown.materials:
        raise InputError(f"--material is for volume fractions: add --as {FRACTIONS}")
    target = checked_target(
        output.out or Path(f"{run.resolve().name}-volume.h5"), output.overwrite, asked in CT_NUMBERS
    )
    stored = open_model(run)
    spectrum = detected_spectrum(stored.basis, stored.transmission)
    wanted = None
    if asked is not None:
        materials = named_materials(shown.materials)
        readouts = Readouts.of(stored.basis, *spectrum)
        wanted = quantity(readouts, asked, shown.energy, shown.water, materials)
    chosen = chosen_grid(stored.grid, place.grid, place.voxel, place.size, place.center, place.like)
    if wanted is not None and wanted.caution:
        click.echo(f"Warning: {wanted.caution}.", err=True)
    set_threads(threads)
    if shown.deviation and wanted is not None:
        stored, wanted = deviation_of(run, stored, wanted)
    bar = ProgressBar("voxelize", "slice", printing.silent)
    write_volume(target, stored, chosen, wanted, bar.update)
    bar.close()
    shape = " x ".join(map(str, chosen.shape))
    said = "basis volumes" if wanted is None else f"{wanted.about}{'' if wanted.unit == '1' else f' [{wanted.unit}]'}"
    found: dict[str, Any] = {"volume": str(target.path), "shape": list(chosen.shape)}
    found |= {"spacing_mm": list(chosen.spacing), "energy": shown.energy}
    if wanted is not None:
        found |= {"quantity": wanted.name, "unit": wanted.unit, "caution": wanted.caution}
    _report(printing.as_json, found, f"Wrote {target.path}: {said}, {shape} voxels")


def _check_deviation(run: Path, asked: str | None, places: dict[str, Any]) -> None:
    """Refuse a standard deviation of the bases, which the run has, or on another grid."""
    from recon.uncertainty.estimate import DEVIATIONS
    from spectra.errors import InputError

    if asked is None:
        raise InputError(f"--deviation needs a quantity by --as; those of the bases are in {run / DEVIATIONS}")
    refuse_options("--deviation", places)


@click.command(
    epilog="\b\nExamples:\n  recon render kedge-run --like kedge.h5\n"
    "  recon render kedge-run --scene-geometry helix.yaml -o helix.h5"
)
@click.argument("run", type=_RUN)
@click.option("-o", "--out", type=_FILE, help="File to write [default: <run>-render.h5].")
@click.option("--like", type=_FILE, metavar="DATASET", help="Views, flats and exposure of a dataset.")
@click.option("--scene-geometry", type=_FILE, metavar="YAML", help="Views of a file with the keys geometry and panel.")
@_common
def render(
    run: Path,
    out: Path | None,
    like: Path | None,
    scene_geometry: Path | None,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Write line integrals of a fitted RUN, and the counts expected in each channel, for any geometry.

    With --like counts are those of the dataset's own pixels and exposures; with --scene-geometry those of ideal pixels,
    each of which gets as many photons as those of the scan that was fitted.
    """
    from recon.output.render_file import views_of_dataset, views_of_file, write_render
    from recon.runs.run_folder import open_run
    from spectra.threads import set_threads

    if (like is None) == (scene_geometry is None):
        raise click.UsageError("Give either --like or --scene-geometry.")
    target = out or Path(f"{run.resolve().name}-render.h5")
    _check_free(target, overwrite)
    fitted = open_run(run)
    views = views_of_dataset(fitted, like) if like is not None else views_of_file(fitted, Path(str(scene_geometry)))
    set_threads(threads)
    bar = ProgressBar("render", "view", quiet or as_json)
    write_render(target, fitted, views, bar.update)
    bar.close()
    panel = views.geometry.panel
    shape = [len(views.geometry), len(views.channels), panel.rows, panel.columns]
    bases = list(fitted.gaussians.basis_names)
    found = {"render": str(target), "shape": shape, "channels": list(views.channels), "bases": bases}
    _report(as_json, found, f"Wrote {target}: {shape[0]} views of {panel.rows} x {panel.columns} pixels")


def _check_free(path: Path, overwrite: bool) -> None:
    from phantomgen.runtime.outputs import check_output
    from recon.output.volume_file import RESULT
    from spectra.errors import InputError

    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"the output {path} is an HDF5 file, whose name ends in {' or '.join(_SUFFIXES)}; "
            "`recon export` writes other formats"
        )
    check_output(path, overwrite, kind=RESULT)


def _report(as_json: bool, found: dict[str, Any], text: str) -> None:
    click.echo(json.dumps(found) if as_json else text)


class ProgressBar:
    """Progress bar on stderr.

    Parameters
    ----------
    what : is done
    unit : of what is counted
    quiet : whether to show nothing
    """

    def __init__(self, what: str, unit: str, quiet: bool) -> None:
        self.what, self.unit, self.quiet = what, unit, quiet
        self.bar: Any = None

    def update(self, done: int, total: int) -> None:
        """Show how many units are done.

        Parameters
        ----------
        done : number of finished units
        total : number of all units
        """
        from tqdm.auto import tqdm

        if self.bar is None:
            self.bar = tqdm(total=total, desc=self.what, unit=self.unit, disable=True if self.quiet else None)
        self.bar.update(done - self.bar.n)

    def close(self) -> None:
        """Remove the bar."""
        if self.bar is not None:
            self.bar.close()
