"""``recon warm-up``: the kernels of reconstructions, compiled ahead."""

import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import click

from phantomgen.cli.common import debug_option, progress_options
from spectra.errors import Error

_SMALL = ("geometry.views=8", "geometry.test_views=1", "panel={rows: 24, columns: 24, pitch: 8.53}", "volume.voxels=16")


@click.command("warm-up", epilog="\b\nExamples:\n  recon warm-up\n  phantomgen warm-up && recon warm-up")
@progress_options
@debug_option
def warm_up(quiet: bool) -> None:
    """Compile the kernels of reconstructions ahead, which a machine does once.

    Scans and fits a small scene. The first fit on a machine compiles them otherwise.
    """
    start = time.perf_counter()
    settings = [part for value in _SMALL for part in ("--set", value)]
    with TemporaryDirectory() as folder:
        path = Path(folder, "warm-up.h5")
        if not quiet:
            click.echo("Compiling kernels, once on this machine: scan ...", err=True)
        command = [sys.executable, "-m", "phantomgen", "make", "--preset", "kedge-small", "-q", "-o", str(path)]
        done = subprocess.run([*command, *settings], capture_output=True, text=True, check=False)
        if done.returncode:
            raise Error(f"the small scan failed: {(done.stderr.strip() or 'no message').splitlines()[-1]}")
        if not quiet:
            click.echo("Compiling kernels, once on this machine: fit ...", err=True)
        from recon.api import fit as fit_scan

        found = fit_scan(path, progress=not quiet)
        found.volume()
        found.score()
    click.echo(f"The kernels of recon are compiled: {time.perf_counter() - start:.1f} s.")
