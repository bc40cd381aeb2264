"""The command ``recon calibrate``: the spectrum of a scanner from counts behind known absorbers."""

from pathlib import Path

import click

from phantomgen.cli.common import debug_option, json_option
from recon.cli.common import PARAMETERS, parse_priors


@click.command(
    epilog="\b\nExamples:\n  recon calibrate wedge.yaml\n"
    "  recon calibrate wedge.yaml --free voltage,filter --prior voltage=1 -o calibrated.yaml"
)
@click.argument("wedge", type=click.Path(dir_okay=False, path_type=Path))
@click.option("-o", "--out", type=click.Path(path_type=Path), help="File to write [default: <wedge>-calibrated.yaml].")
@click.option(
    "--free", metavar="NAME[,NAME]", help=f"What to estimate, of {', '.join(PARAMETERS)} [default: as the file says]."
)
@click.option(
    "--prior",
    metavar="NAME=NUMBER",
    multiple=True,
    callback=parse_priors,
    help="Standard deviation of what is known beforehand of a parameter, about its value in the file; repeatable.",
)
@click.option("--overwrite", is_flag=True, help="Replace a file that exists.")
@json_option
@debug_option
def calibrate(
    wedge: Path, out: Path | None, free: str | None, prior: dict[str, float], overwrite: bool, as_json: bool
) -> None:
    """Estimate tube voltage, filter, thresholds and resolution from the counts in WEDGE.

    WEDGE is a YAML file that says what is known of source and detector, with counts of every channel behind known
    absorbers. Writes values, uncertainties and the sensitivities of the channels; `recon fit --spectrum` takes these.
    """
    from phantomgen.runtime.outputs import check_output
    from phantomgen.runtime.plain_json import to_json
    from recon.calibration.calibrate import Calibration
    from recon.calibration.spectrum_file import is_spectrum
    from recon.calibration.wedge_file import read_calibration

    path = Path(f"{wedge.stem}-calibrated.yaml") if out is None else out
    check_output(path, overwrite, example="calibrated.yaml", kind=("a file of channel sensitivities", is_spectrum))
    names = tuple(name.strip() for name in free.split(",")) if free else ()
    found = Calibration.of(*read_calibration(wedge, names, prior))
    found.write(path)
    if as_json:
        click.echo(to_json({"file": str(path), **found.record()}))
        return
    for sentence in found.sentences:
        click.echo(f"Warning: {sentence}.", err=True)
    click.echo("\n".join(found.lines()))
    freedom = found.model.freedom
    click.echo(f"deviance {found.found.deviance:.4g} for {freedom} degrees of freedom")
    click.echo(f"Wrote {path}; next: recon fit scan.h5 --spectrum {path}")
