"""``phantomgen degrade`` makes a scan worse; ``phantomgen correct`` prepares a raw one for reconstruction."""

import json
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import FiniteRange, Printing, debug_option, grouped, json_option, progress_options


class Parsed(click.ParamType):
    """An option whose text a function reads; a ValueError of the function becomes a sentence.

    Parameters
    ----------
    name : name of the type
    parse : reads the text
    wrong : what is said of a text that cannot be read, after the text itself
    """

    def __init__(self, name: str, parse: Callable[[str], Any], wrong: str) -> None:
        self.name, self.parse, self.wrong = name, parse, wrong

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Read the text; a default is a value already.

        Parameters
        ----------
        value : text, or the default
        param, ctx : of click

        Returns
        -------
        what the function reads
        """
        if not isinstance(value, str):
            return value
        try:
            return self.parse(value.strip())
        except ValueError:
            self.fail(f"{value!r} {self.wrong}", param, ctx)


def _part(text: str) -> float:
    """Part of something, 1 for all: ``20%`` or ``0.2``."""
    return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)


def _arc(text: str) -> tuple[float, float]:
    """First and last angle [degree]: ``30:150``, or ``120`` from 0."""
    first, _, last = text.rpartition(":")
    return float(first or 0), float(last)


def _pixels(text: str) -> float:
    """Length in pixels: ``0.5px`` or ``0.5``."""
    return float(text.removesuffix("px"))


def _levels(text: str) -> tuple[float, ...]:
    """Doses, separated by commas, each once."""
    levels = tuple(float(part) for part in text.split(","))
    if len(set(levels)) < len(levels):
        raise ValueError
    return levels


PART = Parsed("part", _part, "is neither a percentage such as 20% nor a number such as 0.2")
ARC = Parsed("arc", _arc, "is neither an angle such as 120 nor two such as 30:150")
PIXELS = Parsed("pixels", _pixels, "is no number of pixels such as 0.5px")
LEVELS = Parsed("levels", _levels, "is no list of different doses such as 1,0.5,0.25")


@dataclass(frozen=True)
class _Output:
    """The dataset that is written."""

    out: Path
    compression: str
    overwrite: bool


@click.command(
    epilog="\b\nExamples:\n  phantomgen degrade kedge.h5 -o low.h5 --dose 0.25 --views 40\n"
    "  phantomgen degrade kedge.h5 -o limited.h5 --arc 120 --truncate 20% --bin 2\n"
    "  phantomgen degrade kedge.h5 -o wrong.h5 --shift 0.5px --kv-error 2\n"
    "  phantomgen degrade kedge.h5 -o pairs.h5 --levels 1,0.5,0.25 --seed 7"
)
@click.argument("scan", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="The new dataset.")
@click.option("--dose", type=FiniteRange(), default=1.0, help="Part of the dose that is left, such as 0.25.")
@click.option("--levels", type=LEVELS, metavar="D,D,...", help="One file per dose, named OUT-D.h5.")
@click.option("--complement", is_flag=True, help="Write the counts that --dose leaves out, in place of the others.")
@click.option("--flats", type=click.Choice(["keep", "thin"]), default="keep", help="Flats at low dose [default: keep].")
@click.option("--noise", is_flag=True, help="Draw Poisson counts, from a scan made by --no-noise.")
@click.option("--views", type=int, metavar="N", help="Number of training views, evenly spread; test views stay.")
@click.option("--arc", type=ARC, metavar="DEGREES", help="Training views of this arc only: 120, or 30:150.")
@click.option("--truncate", type=PART, default=0.0, metavar="PART", help="Cut off columns, half on each side: 20%.")
@click.option("--bin", "factor", type=int, default=1, metavar="N", help="Sum N x N pixels.")
@click.option("--dead", type=PART, default=0.0, metavar="PART", help="Pixels that die and are marked: 0.1%.")
@click.option("--dead-columns", type=int, default=0, metavar="N", help="Columns that die from end to end, marked.")
@click.option("--hot", type=PART, default=0.0, metavar="PART", help="Pixels that read twice the open beam, not marked.")
@click.option(
    "--saturate", type=FiniteRange(), default=0.0, metavar="X", help="Largest reading of the views, in open beams: 0.5."
)
@click.option("--drift", type=PART, default=0.0, metavar="PART", help="Tube output lost over the scan, not stated: 5%.")
@click.option("--shift", type=PIXELS, default=0.0, metavar="PIXELS", help="State the panel so far from the true one.")
@click.option(
    "--tilt", type=FiniteRange(), default=0.0, metavar="DEG", help="State the panel turned so far in its plane."
)
@click.option(
    "--kv-error", type=FiniteRange(), default=0.0, metavar="KV", help="State a tube voltage so far from the true one."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of photons, dead and hot pixels.")
@click.option("--compression", default="gzip", metavar="gzip|bitshuffle|none", help="Of large arrays [default: gzip].")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@progress_options
@json_option
@debug_option
@grouped(output=_Output, printing=Printing)
def degrade(
    scan: Path,
    output: _Output,
    dose: float,
    levels: tuple[float, ...] | None,
    threads: int | None,
    printing: Printing,
    factor: int,
    **wanted: Any,
) -> None:
    """Write SCAN with less dose, fewer views, a worse panel, or wrong statements; the truth stays.

    Counts are thinned, which is exactly a scan of the lower dose. What was done stands in the file: `phantomgen info`.
    """
    from phantomgen.degradation.run import check_writable, degrade_file, level_path
    from phantomgen.degradation.settings import Degradation
    from spectra.threads import set_threads

    if levels and dose != 1:
        raise click.UsageError("--levels names the doses: leave out --dose")
    jobs = [
        (level_path(output.out, level) if levels else output.out, Degradation(dose=level, bin=factor, **wanted))
        for level in levels or (dose,)
    ]
    if not levels and jobs[0][1] == Degradation(seed=wanted["seed"]):
        raise click.UsageError("nothing is to be changed: see --help for what can be, such as --dose 0.25")
    for path, _ in jobs:
        check_writable(scan, path, output.overwrite)
    set_threads(threads)
    done = [
        degrade_file(
            scan, path, job, overwrite=output.overwrite, compression=output.compression,  # type: ignore[arg-type]
            progress=not printing.silent and sys.stderr.isatty(),
        )
        for path, job in jobs
    ]  # fmt: skip
    if printing.as_json:
        found = [{"file": str(one.path), "shape": one.shape, "history": one.history} for one in done]
        click.echo(json.dumps(found if levels else found[0]))
        return
    for one in done:
        views, channels, rows, columns = one.shape
        click.echo(f"{one.path}: {views} views x {channels} channels x {rows} x {columns}")
        for phrase in one.history:
            click.echo(f"  {phrase}")


@click.command(
    epilog="\b\nExamples:\n  phantomgen correct raw.h5 -o scan.h5\n"
    "  phantomgen correct raw.h5 -o scan.h5 --flats flat_low.tif --flats flat_high.tif\n"
    "  phantomgen correct raw.h5 -o scan.h5 --steps defects,drift"
)
@click.argument("scan", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", required=True, type=click.Path(path_type=Path), help="Dataset to write.")
@click.option(
    "--flats",
    multiple=True,
    type=click.Path(path_type=Path),
    metavar="FILE",
    help="Open-beam frames in place of those of SCAN: a TIFF stack per channel, or one .npy with all channels.",
)
@click.option(
    "--darks", multiple=True, type=click.Path(path_type=Path), metavar="FILE", help="Frames without beam, likewise."
)
@click.option(
    "--steps",
    default="defects,drift,rings",
    metavar="STEP[,STEP]",
    help="What is corrected [default: defects,drift,rings].",
)
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@progress_options
@json_option
@debug_option
@grouped(printing=Printing)
def correct(
    scan: Path,
    out: Path,
    flats: tuple[Path, ...],
    darks: tuple[Path, ...],
    steps: str,
    overwrite: bool,
    printing: Printing,
) -> None:
    """Mask bad pixels of SCAN, and correct its tube output and the gains of its pixels.

    Counts stay as they are, so that their noise stays that of photons: masks, the exposure of the views and the flats
    change. Bad pixels are found by flats and by changes between views, the tube output by parts of the panel that see
    only air, gains by what all views have in common. What was done is printed, and stands in the file.
    """
    from phantomgen.correction.run import Wanted, correct_file
    from phantomgen.importers.files.frames import read_frames

    wanted = Wanted(
        tuple(step.strip() for step in steps.split(",") if step.strip()),
        read_frames(flats) if flats else None,
        read_frames(darks) if darks else None,
    )
    shown = not printing.silent and sys.stderr.isatty()
    done = correct_file(scan, out, wanted, overwrite=overwrite, progress=shown)
    if printing.as_json:
        click.echo(json.dumps({"file": str(done.path), **done.record()}))
        return
    click.echo(f"{done.path}")
    for phrase in done.done:
        click.echo(f"  {phrase}")
