"""Volumes of other programs in a comparison: finished ones, and commands that make one within a budget."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from recon.comparison.contenders import measured_command
from recon.comparison.contenders.contender import contender
from recon.evaluation.stated_volume import OPTIONS
from spectra.errors import InputError

_WITH = "'NAME=PATH as=mono:60 units=1/mm'"
_RUN = "'NAME as=mono:60 units=1/mm: command {dataset} {out}'"
_FLAGS, SUFFIX = ("same-grid",), "suffix"
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
_IDLE = 10.0  # wall time over processor time that a command may take before it counts as hanging
_START = 2.0  # s; that the process which measures may take to start and end
_RUNNING: set[subprocess.Popen] = set()


@dataclass(frozen=True)
class OtherProgram:
    """A volume of another program.

    Parameters
    ----------
    name : in tables and folders
    statement : what the volume holds and where it lies, as options of ``recon score``
    path : of a finished volume; None for a command
    command : words with ``{dataset}`` and ``{out}``, and perhaps ``{budget}`` and ``{threads}``; empty for a path
    suffix : of the file that the command writes
    """

    name: str
    statement: dict[str, str] = field(default_factory=dict)
    path: str | None = None
    command: tuple[str, ...] = ()
    suffix: str = ".npy"

    def __str__(self) -> str:
        return self.name

    @property
    def each_budget(self) -> bool:
        """Whether the command is told its budget, so that it runs once for each."""
        return any("{budget}" in word for word in self.command)


@dataclass(frozen=True)
class Ended:
    """How a command ended.

    Parameters
    ----------
    seconds : time that it took [s]
    memory : largest memory of one of its processes [MiB]; None where the system does not tell
    error : sentence where it has no result; empty where it has
    too_short : whether the budget ended it
    """

    seconds: float
    memory: float | None
    error: str = ""
    too_short: bool = False


def finished_volume(text: str, option: str = "--with") -> OtherProgram:
    """Read the value of ``--with``.

    Parameters
    ----------
    text : such as ``tigre=fdk.npy as=mono:60 units=1/cm axes=zyx same-grid``
    option : that has the value, for messages

    Returns
    -------
    the volume

    Raises
    ------
    InputError
        When the text says none.
    """
    words = _words(text, option, _WITH)
    name, equals, path = words[0].partition("=") if words else ("", "", "")
    if not equals or not path:
        raise InputError(f"{option} takes {_WITH}, got {text!r}")
    return OtherProgram(_checked_name(name, option), _statement(words[1:], option), path)


def command_program(text: str) -> OtherProgram:
    """Read the value of ``--run``.

    Parameters
    ----------
    text : such as ``mine as=mono:60 units=1/mm axes=zyx same-grid: python mine.py {dataset} {out}``

    Returns
    -------
    the command

    Raises
    ------
    InputError
        When the text says none, or the command does not name its input and output.
    """
    head, colon, command = text.partition(": ")
    words, parts = _words(head, "--run", _RUN), tuple(_words(command, "--run", _RUN))
    if not colon or not words or not all(any(place in part for part in parts) for place in ("{dataset}", "{out}")):
        raise InputError(f"--run takes {_RUN}, got {text!r}")
    statement = _statement(words[1:], "--run", (SUFFIX,))
    suffix = statement.pop(SUFFIX, ".npy")
    suffix = suffix if suffix.startswith(".") else f".{suffix}"
    return OtherProgram(_checked_name(words[0], "--run"), statement, None, parts, suffix)


def check_names(programs: Sequence[OtherProgram]) -> None:
    """Refuse names that occur twice.

    Parameters
    ----------
    programs : all of a comparison

    Raises
    ------
    InputError
        When it is so.
    """
    names = [program.name for program in programs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"--with and --run must have names of their own, {', '.join(twice)} occurs twice")


def run_command(
    program: OtherProgram, dataset: Path, out: Path, budget: float, clock: str, threads: int | None
) -> Ended:
    """Run a command until it ends or its budget is over; its whole process group is ended then.

    Parameters
    ----------
    program : the command
    dataset : file that it reads
    out : file that it is to write; removed before
    budget : [s]
    clock : ``wall`` or ``cpu``
    threads : number that common libraries are told; None for all

    Returns
    -------
    how it ended. Its messages are beside `out`
    """
    report, messages = (out.with_name(f"{out.name}.{kind}") for kind in ("json", "log"))
    for path in (out, report):
        path.unlink(missing_ok=True)
    values = {"dataset": str(dataset.resolve()), "out": str(out.resolve()), "budget": f"{budget:g}"}
    values["threads"] = str(threads or os.cpu_count() or 1)
    words = [
        sys.executable,
        "-I",
        measured_command.__file__,
        str(report),
        *(_filled(w, values) for w in program.command),
    ]
    environment = os.environ | ({} if threads is None else dict.fromkeys(_THREADS, str(threads)))
    limit = (budget if clock == "wall" else _IDLE * budget + 60) + _START
    with messages.open("w", encoding="utf-8") as log:
        process = subprocess.Popen(words, stdout=log, stderr=log, env=environment, start_new_session=True)
        _RUNNING.add(process)
        try:
            process.wait(timeout=limit)
        except subprocess.TimeoutExpired:
            pass  # there is no report
        finally:
            _end(process)
    told = json.loads(report.read_text(encoding="utf-8")) if report.is_file() else {}
    report.unlink(missing_ok=True)
    if "error" in told:
        return Ended(0.0, None, told["error"])
    used = told.get("processor") if clock == "cpu" else None
    seconds = float(used if used is not None else told.get("seconds", np.inf))
    if seconds > budget:
        out.unlink(missing_ok=True)
        return Ended(
            seconds, told.get("memory"), f"nothing is ready within {budget:g} s: the command did not end", True
        )
    if told["status"]:
        error = f"the command ended with status {told['status']}: {_last_line(messages)}"
        return Ended(seconds, told["memory"], error)
    if not out.exists():
        return Ended(seconds, told["memory"], f"the command ended without writing {out.name}")
    return Ended(seconds, told["memory"])


def end_commands() -> None:
    """End the commands that this process has started."""
    for process in tuple(_RUNNING):
        _end(process)


def _end(process: subprocess.Popen) -> None:
    """End a command with all that it has started."""
    if sys.platform != "win32":
        with suppress(ProcessLookupError, PermissionError):  # nothing of it is left
            os.killpg(process.pid, signal.SIGKILL)
    elif process.poll() is None:
        process.kill()
    process.wait()
    _RUNNING.discard(process)


def _filled(word: str, values: dict[str, str]) -> str:
    """A word of a command with its places filled; other braces stay."""
    return re.sub(r"\{(dataset|out|budget|threads)\}", lambda found: values[found.group(1)], word)


def _words(text: str, option: str, example: str) -> list[str]:
    try:
        return shlex.split(text)
    except ValueError as error:
        raise InputError(f"{option} takes {example}, got {text!r}: {error}") from None


def _statement(words: Sequence[str], option: str, more: tuple[str, ...] = ()) -> dict[str, str]:
    """Options of ``recon score`` from words such as ``units=1/mm``."""
    found = {}
    for word in words:
        key, equals, value = word.partition("=")
        if key not in (*OPTIONS, *more) or (not value and key not in _FLAGS):
            known = ", ".join(name if name in _FLAGS else f"{name}=..." for name in (*OPTIONS, *more))
            raise InputError(f"{option}: {word!r} states nothing about a volume: choose from {known}")
        found[key] = value if equals else "yes"
    return found


def _checked_name(name: str, option: str) -> str:
    """A name that can be a folder, and is not that of a method."""
    if not re.fullmatch(r"\w[\w.-]*", name):
        raise InputError(f"{option}: a name has letters, digits, dots and dashes, got {name!r}")
    try:
        contender(name)
    except InputError:
        return name
    raise InputError(f"{option}: {name} is the name of a method: choose another")


def _last_line(messages: Path) -> str:
    lines = messages.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    return lines[-1] if lines else "no message"
