"""The command ``phantomgen``: parse, call, print.

Results go to stdout, progress and warnings to stderr. Exit codes: 0 done, 1 an error in one sentence, 2 wrong usage,
3 finished but a check failed, 130 interrupted.
"""

import click

from phantomgen.cli.analysis.dose import dose
from phantomgen.cli.analysis.spectrum import materials, optimize_thresholds, spectrum
from phantomgen.cli.analysis.stress import stress
from phantomgen.cli.batch import batch, suite
from phantomgen.cli.common import Commands, version_option
from phantomgen.cli.dataset import info, schema, validate
from phantomgen.cli.degrade_and_correct import correct, degrade
from phantomgen.cli.export import export
from phantomgen.cli.importers import import_
from phantomgen.cli.make import make, warm_up
from phantomgen.cli.plan import plan
from phantomgen.cli.presets import presets
from phantomgen.cli.report import report
from phantomgen.cli.view import view


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="\b\nExamples:\n  phantomgen make kedge\n  phantomgen presets show kedge > my.yaml",
)
@version_option("phantomgen")
def main() -> None:
    """Make spectral-CT scans of phantoms whose truth is known.

    A scene (shapes, materials, source, detector, orbit) becomes one HDF5 file: photon counts per view, channel and
    pixel, all that a reconstructor may know, and the truth to judge it against.
    """


for command in (
    make,
    plan,
    batch,
    degrade,
    correct,
    suite,
    info,
    validate,
    view,
    report,
    stress,
    export,
    presets,
    import_,
    materials,
    spectrum,
    optimize_thresholds,
    dose,
    schema,
    warm_up,
):
    main.add_command(command)
