"""``phantomgen warm-up``: kernels compiled ahead."""

import time

import click

from phantomgen.cli.common import debug_option


@click.command("warm-up", epilog="\b\nExamples:\n  phantomgen warm-up\n  recon warm-up")
@click.option("-q", "--quiet", is_flag=True, help="No progress bar.")
@debug_option
def warm_up(quiet: bool) -> None:
    """Compile the kernels of scans ahead, which a machine does once.

    The first scan on a machine compiles them otherwise. Useful in the build of a container image, and before a lesson.
    `recon warm-up` compiles those of reconstructions as well.
    """
    from tqdm.auto import tqdm

    from phantomgen.warm_up import STEPS

    start = time.perf_counter()
    bar = tqdm(STEPS.items(), desc="compiling", unit="group", disable=True if quiet else None)
    for name, step in bar:
        bar.set_postfix_str(name)
        step()
    click.echo(f"The kernels of phantomgen are compiled: {time.perf_counter() - start:.1f} s.")
