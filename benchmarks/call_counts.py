"""Calls between the source files of a fit or a simulation: files that run, pairs of files, and climbs.

    python -m benchmarks.call_counts fit --list
    python -m benchmarks.call_counts simulate

A call is followed from the file of the calling function to that of the called one; functions of other libraries
between them are skipped, and what runs while a module is imported does not count. Every pair of files counts once,
however often it is called. A climb is a pair whose called file lies in a higher layer than the calling one, by the
import contracts of pyproject.toml: a callback, a method of an object from above, or a decorator. Pieces of work that
`spectra.threads` runs are counted apart.

The path of the counts of a fit is the part of these calls that hands over the counts, from the command to the first
evaluation of the likelihood of Gaussians: an argument is an open dataset, the measurements read from it, or an array
named counts. The path of the scan of a simulation is the part that hands over the scan.
"""

import argparse
import sys
import tempfile
import threading
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
import yaml
from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon

ROOT = Path(__file__).parents[1]
PACKAGES = ("recon", "phantomgen", "spectra")
HOLDERS = ("Dataset", "Measurements", "Scan")  # classes that hold counts, or what is simulated
NAME = "counts"  # of an argument that is an array of counts
LAST = {"fit": "recon.gaussians.likelihood", "simulate": None}  # where the path of the counts ends
MAP = "spectra.threads"  # runs pieces of work in threads, so that every kernel is called from there
PIXELS, VIEWS, VOXELS = 16, 9, 12  # of the scan; calls do not depend on them

Pair = tuple[str, str]


@dataclass
class Calls:
    """Profiling function that notes pairs of modules; see `sys.setprofile`.

    Parameters
    ----------
    until : module at which the path of the counts ends, or None
    pairs : caller and callee, with the function that was called first
    before : those before `until` was entered
    with_counts : those of `before` that handed over counts
    """

    until: str | None
    pairs: dict[Pair, str] = field(default_factory=dict)
    before: dict[Pair, str] = field(default_factory=dict)
    with_counts: dict[Pair, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._names: dict[CodeType, str | None] = {}
        self._ended = False

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Note the call of a function of this project by another file of it."""
        if event != "call" or (callee := self._module(frame)) is None:
            return
        caller = self._caller(frame)
        if caller is None or caller == callee:
            return
        pair = (caller, callee)
        self.pairs.setdefault(pair, frame.f_code.co_qualname)
        if not self._ended:
            self.before.setdefault(pair, frame.f_code.co_qualname)
            if _has_counts(frame):
                self.with_counts.setdefault(pair, frame.f_code.co_qualname)
        self._ended |= callee == self.until

    def _caller(self, frame: FrameType) -> str | None:
        """Module of the nearest function of this project that waits for a frame; None within an import."""
        found: str | None = None
        above: FrameType | None = frame
        while above is not None:
            if above.f_code.co_name == "<module>" and self._module(above) is not None:
                return None
            found = found or (None if above is frame else self._module(above))
            above = above.f_back
        return found

    def _module(self, frame: FrameType) -> str | None:
        """Name of the module of a function of this project, as the import contracts write it."""
        code = frame.f_code
        if code not in self._names:
            self._names[code] = _module_of(code.co_filename)
        return self._names[code]


def _module_of(file: str) -> str | None:
    path = Path(file)
    if not path.is_absolute() or not path.is_relative_to(ROOT) or path.relative_to(ROOT).parts[0] not in PACKAGES:
        return None
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def _has_counts(frame: FrameType) -> bool:
    code = frame.f_code
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    found = ((name, frame.f_locals.get(name)) for name in names)
    return any(type(value).__name__ in HOLDERS or (name == NAME and hasattr(value, "shape")) for name, value in found)


def layers() -> dict[str, dict[str, int]]:
    """Read the import contracts.

    Returns
    -------
    by container, "" for the packages themselves: the place of each module, 0 for the highest layer
    """
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    found = {}
    for contract in settings["contracts"]:
        if contract["type"] != "layers":
            continue
        places = {
            module.strip(): place for place, layer in enumerate(contract["layers"]) for module in layer.split("|")
        }
        found.update(dict.fromkeys(contract.get("containers", ("",)), places))
    return found


def is_climb(pair: Pair, contracts: dict[str, dict[str, int]]) -> bool:
    """Tell whether a call goes from a lower layer to a higher one.

    Parameters
    ----------
    pair : calling and called module
    contracts : of `layers`

    Returns
    -------
    True where it does; a package is above the modules in it
    """
    caller, callee = (module.split(".") for module in pair)
    shared = 0
    while shared < min(len(caller), len(callee)) and caller[shared] == callee[shared]:
        shared += 1
    if shared in (len(caller), len(callee)):
        return shared == len(callee)
    places = contracts.get(".".join(caller[:shared]), {})
    return places.get(caller[shared], 0) > places.get(callee[shared], 0)


def trace(work: Callable[[], Any], until: str | None) -> Calls:
    """Run a function with profiling in all threads.

    Parameters
    ----------
    work : function to run
    until : see `Calls`

    Returns
    -------
    its calls
    """
    calls = Calls(until)
    threading.setprofile(calls)
    sys.setprofile(calls)
    try:
        work()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)  # type: ignore[arg-type] - it may be None
    return calls


def scan_command(path: Path) -> list[str]:
    """List the words of the command that simulates the small scan.

    Parameters
    ----------
    path : file to write

    Returns
    -------
    arguments of ``phantomgen``
    """
    text = resources.files("phantomgen").joinpath("scene", "presets", "kedge-small.yaml").read_text()
    panel = yaml.safe_load(text)["panel"]
    pitch = panel["columns"] * np.ravel(panel["pitch"])[-1] / PIXELS
    settings = (
        f"geometry.views={VIEWS}", "geometry.test_views=2", "flats=5", f"panel.rows={PIXELS}",
        f"panel.columns={PIXELS}", f"panel.pitch={pitch}",
    )  # fmt: skip
    words = [word for setting in settings for word in ("--set", setting)]
    return ["make", "kedge-small", "-o", str(path), "--voxels", str(VOXELS), "--threads", "1", "-q", *words]


def report(calls: Calls, listed: bool) -> list[str]:
    """Describe calls in text.

    Parameters
    ----------
    calls : to describe
    listed : whether to name files and climbs

    Returns
    -------
    lines
    """
    contracts, lines = layers(), []
    sections = {"all calls": calls.pairs}
    if calls.until is not None:
        sections[f"before {calls.until}"] = calls.before
    sections["path of the counts or the scan"] = calls.with_counts
    for name, pairs in sections.items():
        files = sorted({module for pair in pairs for module in pair})
        climbs = {pair: function for pair, function in pairs.items() if is_climb(pair, contracts)}
        pieces = sum(caller == MAP for caller, _ in climbs)
        lines.append(
            f"{name}: {len(files)} files, {len(pairs)} pairs, {len(climbs) - pieces} climbs, {pieces} of {MAP}"
        )
        if listed:
            lines += [f"  file {module}" for module in files]
            lines += [f"  climb {a} -> {b}: {function}" for (a, b), function in sorted(climbs.items())]
    return lines


def main() -> None:
    """Trace a command on the small scan and print the numbers."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=["fit", "simulate"])
    parser.add_argument("--list", action="store_true", help="name files and climbs")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scan, run = Path(folder) / "scan.h5", Path(folder) / "run"

        def make() -> None:
            _run(phantomgen, scan_command(scan))

        def fit() -> None:
            _run(recon, ["fit", str(scan), "-o", str(run), "--threads", "1", "-q"])

        if arguments.command == "fit":
            make()
        calls = trace(fit if arguments.command == "fit" else make, LAST[arguments.command])
    print("\n".join(report(calls, arguments.list)))


def _run(command: Any, words: list[str]) -> None:
    result = CliRunner().invoke(command, words, catch_exceptions=False)
    if result.exit_code:
        raise SystemExit(result.stderr)


if __name__ == "__main__":
    main()
