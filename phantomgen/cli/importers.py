"""``phantomgen import``: scans of scanners and of other programs as datasets, and their phantoms as scene files."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import debug_option, json_option, progress_options, views_bar


class Numbers(click.ParamType):
    """Numbers, separated by commas."""

    name = "numbers"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Read numbers.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        the numbers
        """
        try:
            return value if isinstance(value, tuple) else tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is no list of numbers such as 20,45,63.3", param, ctx)


class Names(click.ParamType):
    """Names, separated by commas."""

    name = "names"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[str, ...]:
        """Read names.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        the names
        """
        del param, ctx
        return value if isinstance(value, tuple) else tuple(part.strip() for part in str(value).split(","))


@click.group(
    "import",
    epilog="\b\nExamples:\n"
    "  phantomgen import nikon walnut.xtekct -o walnut.h5 --kvp 90 --filter '0.5 mm Cu' --photons 20000\n"
    "  phantomgen import nxtomo low.nx high.nx -o scan.h5 --kvp 120 --filter '2 mm Al' --thresholds 20,60\n"
    "  phantomgen import tiff scan.yaml -o scan.h5\n"
    "  phantomgen import forbild HeadPhantom.pha -o head.yaml\n"
    "  phantomgen import icrp P110/AM -o chest.yaml --heights 1150:1500 --without arm,hand,humer",
)
def import_() -> None:
    """Turn scans of scanners and of other programs into datasets, and phantoms into scenes."""


@import_.command(
    "forbild",
    epilog="\b\nExamples:\n  phantomgen import forbild HeadPhantom.pha -o head.yaml\n  phantomgen make head.yaml",
)
@click.argument("file", type=click.Path(dir_okay=False))
@click.option("-o", "--out", required=True, type=click.Path(dir_okay=False), help="The scene to write.")
@click.option("--overwrite", is_flag=True, help="Replace a scene that exists.")
@json_option
@debug_option
def import_forbild(file: str, out: str, overwrite: bool, as_json: bool) -> None:
    """Write a scene from FILE, a phantom in the text format of the FORBILD group.

    Lengths become millimetres; a later object replaces what it overlaps. A scan is put around it, to be edited.
    """
    from phantomgen.importers.forbild import forbild_scene
    from phantomgen.runtime.outputs import check_output

    path = Path(out)
    check_output(path, overwrite)
    path.write_text(forbild_scene(file), encoding="utf-8")
    click.echo(json.dumps({"file": str(path)}) if as_json else f"{path}\nnext     phantomgen view {path}")


@import_.command(
    "icrp",
    epilog="\b\nExamples:\n"
    "  phantomgen import icrp P110/AM -o chest.yaml --heights 1150:1500 --without arm,hand,humer\n"
    "  phantomgen import icrp P143/10F -o child.yaml --shape 235,150,280 --voxel 1.4,1.4,5",
)
@click.argument("folder", type=click.Path(file_okay=False, path_type=Path))
@click.option("-o", "--out", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The scene to write.")
@click.option("--heights", metavar="LOW:HIGH", help="Part of the body, above the soles in mm [default: all].")
@click.option("--without", type=Names(), default=(), metavar="WORD,...", help="Leave out organs with these words.")
@click.option("--shape", type=Numbers(), metavar="N,N,N", help="Columns, rows and slices; known for AM and AF.")
@click.option("--voxel", type=Numbers(), metavar="X,Y,Z", help="Edges of a voxel in mm; known for AM and AF.")
@click.option("--overwrite", is_flag=True, help="Replace a scene that exists.")
@json_option
@debug_option
def import_icrp(
    folder: Path,
    out: Path,
    heights: str | None,
    without: tuple[str, ...],
    shape: tuple[float, ...] | None,
    voxel: tuple[float, ...] | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write a scene from FOLDER, a voxel phantom in the format of ICRP Publication 110.

    Organs get the compositions and densities of the publication; OUT-labels.npz beside the scene has their voxels. A
    scan is put around the body, to be edited. The phantoms themselves are to be had from the ICRP.
    """
    from phantomgen.importers.icrp import read_phantom, write_scene

    part = _range(heights)
    phantom = read_phantom(folder, _whole("--shape", shape), _three("--voxel", voxel))
    scene, labels = write_scene(phantom, out, heights=part, without=without, overwrite=overwrite)
    found = {"file": str(scene), "labels": str(labels)}
    click.echo(json.dumps(found) if as_json else f"{scene}\n{labels}\nnext     phantomgen view {scene}")


def _three(name: str, values: tuple[float, ...] | None) -> tuple[float, ...] | None:
    """Three numbers above 0."""
    if values is not None and not (len(values) == 3 and all(0 < value < float("inf") for value in values)):
        raise click.UsageError(f"{name} needs three numbers above 0, such as 2.137,2.137,8")
    return values


def _whole(name: str, values: tuple[float, ...] | None) -> tuple[int, ...] | None:
    """Three whole numbers above 0."""
    if _three(name, values) is None or values is None:
        return None
    if any(value != int(value) or value > 10_000 for value in values):
        raise click.UsageError(f"{name} needs three whole numbers up to 10000, such as 254,127,222")
    return tuple(int(value) for value in values)


def _range(text: str | None) -> tuple[float, float] | None:
    """Two numbers that ascend, with a colon between them."""
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = 0.0
    if not low < high < float("inf"):
        raise click.UsageError(f"--heights needs two numbers that ascend, such as 1150:1500, got {text!r}")
    return low, high


_STATED = (
    click.option("--kvp", type=float, metavar="KV", help="Tube voltage."),
    click.option("--filter", "filters", metavar="LAYERS", help="Filters: '2.5 mm Al + 0.2 mm Cu', or none."),
    click.option("--anode", default="tungsten", help="Target of the tube [default: tungsten]."),
    click.option("--anode-angle", type=float, default=12.0, metavar="DEG", help="Angle of the target [default: 12]."),
    click.option("--energy", type=float, metavar="KEV", help="Energy of a monochromatic beam."),
    click.option("--spectrum", type=click.Path(dir_okay=False, path_type=Path), metavar="FILE",
                 help="Spectrum: a table of energy [keV] and photons per bin."),
    click.option("--thresholds", type=Numbers(), metavar="KEV,...", help="Lower limits of photon-counting channels."),
    click.option("--sensor", default="1.6 mm CdTe", help="Sensor of the counters [default: 1.6 mm CdTe]."),
    click.option("--scintillator", metavar="NAME", help="Scintillator that adds energies: CsI, GOS, '0.6 mm CsI'."),
    click.option("--photons", type=float, metavar="N", help="Photons per pixel and view in the open beam."),
    click.option("--white", type=float, metavar="LEVEL", help="Reading of a pixel in the open beam."),
    click.option("--sod", type=float, metavar="MM", help="Distance from source to rotation axis."),
    click.option("--sdd", type=float, metavar="MM", help="Distance from source to panel."),
    click.option("--pitch", type=Numbers(), metavar="MM", help="Pixel pitch; between rows, between columns."),
    click.option("--axis-column", type=float, metavar="N", help="Column that the rotation axis is projected to."),
    click.option("--reverse", is_flag=True, help="The source turns the other way round."),
    click.option("--mirror", is_flag=True, help="Columns are stored in the opposite order."),
    click.option("--flip-rows", is_flag=True, help="Rows are stored in the opposite order."),
)  # fmt: skip
_WANTED = (
    click.option("--basis", type=Names(), default=(), metavar="NAME,...",
                 help="photoelectric, compton, K-edge elements, materials [default: the first two, or water]."),
    click.option("--air", metavar="ROWS,COLUMNS", help="Part of the panel that sees air in every view: 0:16,0:256."),
    click.option("--cumulative", is_flag=True, help="A channel counts all photons above its threshold."),
    click.option("--bin", type=click.IntRange(min=1), default=1, metavar="N", help="Sum N x N pixels."),
    click.option("--every", type=click.IntRange(min=1), default=1, metavar="N", help="Take every Nth view."),
    click.option("--test-views", type=click.IntRange(min=0), default=0, metavar="N", help="Views kept for tests."),
    click.option("--voxels", type=click.IntRange(min=1), metavar="N", help="Voxels along x and y."),
    click.option("--size", type=click.FloatRange(min=0, min_open=True), metavar="MM", help="Extent along x and y."),
)  # fmt: skip


def _scan_command(name: str, argument: str, examples: tuple[str, ...], text: str, several: bool = False) -> None:
    """Add the command of a format."""

    def command(paths: Any, **options: Any) -> None:
        _import_scan(name, paths if several else (paths,), **options)

    command.__doc__ = text
    decorators: list[Callable] = [
        click.argument(
            "paths", metavar=argument, nargs=-1 if several else 1, required=True, type=click.Path(path_type=Path)
        ),
        click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="The dataset to write."),
        *_STATED,
        *_WANTED,
        click.option("--title", help="Name of the scan."),
        click.option("--overwrite", is_flag=True, help="Replace a dataset that exists."),
        progress_options,
        json_option,
        debug_option,
    ]
    for decorate in reversed(decorators):
        command = decorate(command)
    lines = "\n".join(f"  phantomgen import {name} {example}" for example in examples)
    import_.command(name, epilog=f"\b\nExamples:\n{lines}")(command)


def _import_scan(name: str, paths: tuple[Path, ...], out: Path, as_json: bool, quiet: bool, **options: Any) -> None:
    """Read a scan, write its dataset, and say what was done."""
    from phantomgen.dataset.reader import parse_region
    from phantomgen.importers.formats import import_scan

    pitch = options["pitch"]
    if pitch is not None and (len(pitch) > 2 or min(pitch) <= 0):
        raise click.UsageError("--pitch needs one positive number, or two: between rows, between columns")
    options["pitch"] = None if pitch is None else (pitch[0], pitch[-1])
    options["air"] = None if options["air"] is None else parse_region(options["air"])
    with views_bar(quiet or as_json) as on_view:
        done = import_scan(name, paths, out, on_view=on_view, **options)
    grid = {"shape": list(done.grid.shape), "spacing": list(done.grid.spacing), "origin": list(done.grid.origin)}
    if as_json:
        found = {"file": str(out), "shape": list(done.shape), "channels": list(done.channels), "grid": grid}
        click.echo(json.dumps({**found, "notes": list(done.notes)}))
        return
    views, channels, rows, columns = done.shape
    voxels = f"{' x '.join(map(str, done.grid.shape))} voxels of {done.grid.spacing[0]:.4g} mm"
    click.echo(f"{out}: {views} views x {channels} channels x {rows} x {columns}; {voxels}")
    for note in done.notes:
        click.echo(f"  {note}")
    click.echo(f"next     recon fit {out}")


_scan_command(
    "tiff",
    "FILE.yaml",
    ("scan.yaml -o scan.h5", "scan.yaml -o scan.h5 --kvp 120 --filter '2.5 mm Al' --thresholds 20,50"),
    """Write a dataset from TIFF files and FILE.yaml, which says where the views are and what the images hold.

    The file has the keys `geometry` and `panel` of scene files, `values` (counts, readings or line-integrals),
    `views`, `flats` and `darks` (patterns such as {channel}/view_*.tif), `channels`, `exposure`, and `beam` with kvp,
    filter, energy, spectrum, thresholds, scintillator and photons.
    """,
)
_scan_command(
    "nxtomo",
    "FILE...",
    (
        "low.nx high.nx -o scan.h5 --kvp 120 --filter '2 mm Al' --thresholds 20,60",
        "scan.nx -o scan.h5 --energy 25 --scintillator '0.1 mm CdWO4' --photons 20000",
    ),
    """Write a dataset from NXtomo FILEs: flats, projections and darks by image_key, angles, distances, z_translation.

    Channels are files, entries of a file, or the second axis of a stack. Values are counts unless --photons or
    --scintillator says that they are readings. Without distances, the beam is parallel.
    """,
    several=True,
)
_scan_command(
    "dxchange",
    "FILE...",
    (
        "scan.h5 -o set.h5 --pitch 0.00065 --energy 25 --scintillator '0.1 mm CdWO4' --photons 20000",
        "low.h5 high.h5 -o set.h5 --pitch 0.1 --kvp 100 --filter '2 mm Al' --thresholds 20,50",
    ),
    """Write a dataset from Data Exchange FILEs of a parallel beam, as TomoPy's dxchange reads them.

    Channels are files, or groups exchange, exchange1, ... of a file. Values are counts unless --photons or
    --scintillator says that they are readings.
    """,
    several=True,
)
_scan_command(
    "nikon",
    "FILE.xtekct",
    (
        "walnut.xtekct -o walnut.h5 --kvp 90 --filter '0.5 mm Cu' --photons 20000",
        "walnut.xtekct -o walnut.h5 --filter none --photons 20000 --bin 4 --every 4",
    ),
    """Write a dataset from FILE.xtekct of a Nikon scanner and the TIFF or raw files beside it.

    Distances, pixels, axis, angles, voltage and filter are those of the file. Readings are divided by WhiteLevel
    (--white) and scaled to --photons. A single radiogram stands for all views of a body of revolution.
    """,
)
_scan_command(
    "fips",
    "FILE.txt",
    ("20200805_pine_cone.txt -o cone.h5 --filter '0.5 mm Cu' --photons 20000 --white 60000 --bin 4",),
    """Write a dataset from FILE.txt of a set of FIPS or Helsinki and the TIFF files beside it.

    The format has no flats: --white or --air state the reading in the open beam. It does not say which way the sample
    turns: add --reverse if the volume is blurred.
    """,
)
_scan_command(
    "bruker",
    "FILE.log",
    ("bone.log -o bone.h5 --photons 10000 --bin 4", "bone.log -o bone.h5 --photons 10000 --axis-column 511.3"),
    """Write a dataset from FILE.log of a Bruker or SkyScan scanner and the TIFF files beside it.

    The white level is 2^depth - 1 unless --white states another.
    """,
)
_scan_command(
    "ctsimu",
    "FILE_metadata.json",
    ("projections/scan_metadata.json -o scan.h5 --photons 40000",),
    """Write a dataset from FILE_metadata.json of CTSimU, the projections that it names, and their scenario.

    Source, panel and stage stand as the scenario says, with the deviations and drifts that are known to the
    reconstruction; the volume has the axes of the stage.
    """,
)
_scan_command(
    "dicom-ct-pd",
    "FOLDER...",
    (
        "L067 -o L067.h5 --kvp 120 --filter '6 mm Al'",
        "low high -o scan.h5 --kvp 120 --filter '6 mm Al' --thresholds 25,65",
    ),
    """Write a dataset from FOLDERs of DICOM-CT-PD files, one per view, of a helical or circular scan.

    A curved detector and a deflected focal spot are kept as they are. Log projections become counts of --photons, or
    of PhotonStatistics where the files have it. Needs pydicom: pip install 'spectral-ct[dicom]'.
    """,
    several=True,
)
_LOGS = """
    Log projections become counts of --photons incident photons per pixel. Voxels and test views are those of the
    format.
    """
_scan_command(
    "r2",
    "FOLDER...",
    ("0_chest_cone -o chest.h5 --kvp 120 --filter '6 mm Al' --scintillator CsI --photons 1e5",),
    f"""Write a dataset from FOLDERs of R2-Gaussian, one per channel.
    {_LOGS}""",
    several=True,
)
_scan_command(
    "naf",
    "FILE...",
    ("chest_50.pickle -o chest.h5 --kvp 120 --filter '6 mm Al' --scintillator CsI --photons 1e5",),
    f"""Write a dataset from pickles of NAF or SAX-NeRF, one per channel; nothing in them is run.
    {_LOGS}""",
    several=True,
)
