"""``phantomgen degrade``: a scan with less dose, fewer views, a worse panel, or wrong statements."""

import json
import sys
from pathlib import Path
from typing import Any

import click

from phantomgen.cli.common import FiniteRange, debug_option, json_option


class Part(click.ParamType):
    """A part of something: ``20%`` or ``0.2``."""

    name = "part"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read a part.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        the part, 1 for all
        """
        text = str(value).strip()
        try:
            return float(text.removesuffix("%")) / (100 if text.endswith("%") else 1)
        except ValueError:
            self.fail(f"{value!r} is neither a percentage such as 20% nor a number such as 0.2", param, ctx)


class Arc(click.ParamType):
    """An arc: its length, or first and last angle, in degrees."""

    name = "arc"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Read an arc.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        first and last angle [degree]
        """
        first, _, last = str(value).rpartition(":")
        try:
            return float(first or 0), float(last)
        except ValueError:
            self.fail(f"{value!r} is neither an angle such as 120 nor two such as 30:150", param, ctx)


class Pixels(click.ParamType):
    """A length in pixels: ``0.5px`` or ``0.5``."""

    name = "pixels"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Read a length.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        pixels
        """
        try:
            return float(str(value).strip().removesuffix("px"))
        except ValueError:
            self.fail(f"{value!r} is no number of pixels such as 0.5px", param, ctx)


class Levels(click.ParamType):
    """Doses, separated by commas."""

    name = "levels"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, ...]:
        """Read doses.

        Parameters
        ----------
        value : text
        param, ctx : of click

        Returns
        -------
        doses
        """
        if isinstance(value, tuple):
            return value
        try:
            levels = tuple(float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"{value!r} is no list of doses such as 1,0.5,0.25", param, ctx)
        if len(set(levels)) < len(levels):
            self.fail(f"{value!r} names a dose twice", param, ctx)
        return levels


@click.command(
    epilog="\b\nExamples:\n  phantomgen degrade kedge.h5 -o low.h5 --dose 0.25 --views 40\n"
    "  phantomgen degrade kedge.h5 -o limited.h5 --arc 120 --truncate 20% --bin 2\n"
    "  phantomgen degrade kedge.h5 -o wrong.h5 --shift 0.5px --kv-error 2\n"
    "  phantomgen degrade kedge.h5 -o pairs.h5 --levels 1,0.5,0.25 --seed 7"
)
@click.argument("scan", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), required=True, help="The new dataset.")
@click.option("--dose", type=FiniteRange(), default=1.0, help="Part of the dose that is left, such as 0.25.")
@click.option("--levels", type=Levels(), metavar="D,D,...", help="One file per dose, named OUT-D.h5.")
@click.option("--complement", is_flag=True, help="Write the counts that --dose leaves out, in place of the others.")
@click.option("--flats", type=click.Choice(["keep", "thin"]), default="keep", help="Flats at low dose [default: keep].")
@click.option("--noise", is_flag=True, help="Draw Poisson counts, from a scan made by --no-noise.")
@click.option("--views", type=int, metavar="N", help="Number of training views, evenly spread; test views stay.")
@click.option("--arc", type=Arc(), metavar="DEGREES", help="Training views of this arc only: 120, or 30:150.")
@click.option("--truncate", type=Part(), default=0.0, metavar="PART", help="Cut off columns, half on each side: 20%.")
@click.option("--bin", "factor", type=int, default=1, metavar="N", help="Sum N x N pixels.")
@click.option("--dead", type=Part(), default=0.0, metavar="PART", help="Pixels that die and are marked: 0.1%.")
@click.option("--shift", type=Pixels(), default=0.0, metavar="PIXELS", help="State the panel so far from the true one.")
@click.option(
    "--kv-error", type=FiniteRange(), default=0.0, metavar="KV", help="State a tube voltage so far from the true one."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, help="Seed of photons and dead pixels.")
@click.option("--compression", default="gzip", metavar="gzip|bitshuffle|none", help="Of large arrays [default: gzip].")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@click.option("--threads", type=click.IntRange(min=1), help="Number of threads [default: all].")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@json_option
@debug_option
def degrade(
    scan: Path,
    out: Path,
    dose: float,
    levels: tuple[float, ...] | None,
    compression: str,
    overwrite: bool,
    threads: int | None,
    quiet: bool,
    as_json: bool,
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
        (level_path(out, level) if levels else out, Degradation(dose=level, bin=factor, **wanted))
        for level in levels or (dose,)
    ]
    if not levels and jobs[0][1] == Degradation(seed=wanted["seed"]):
        raise click.UsageError("nothing is to be changed: see --help for what can be, such as --dose 0.25")
    for path, _ in jobs:
        check_writable(scan, path, overwrite)
    set_threads(threads)
    done = [
        degrade_file(
            scan, path, job, overwrite=overwrite, compression=compression,  # type: ignore[arg-type]
            progress=not (quiet or as_json) and sys.stderr.isatty(),
        )
        for path, job in jobs
    ]  # fmt: skip
    if as_json:
        found = [{"file": str(one.path), "shape": one.shape, "history": one.history} for one in done]
        click.echo(json.dumps(found if levels else found[0]))
        return
    for one in done:
        views, channels, rows, columns = one.shape
        click.echo(f"{one.path}: {views} views x {channels} channels x {rows} x {columns}")
        for phrase in one.history:
            click.echo(f"  {phrase}")
