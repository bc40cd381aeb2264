"""Which numbers of the documents still hold: runs their commands, and compares.

    python -m benchmarks.check_numbers [--only WORD ...] [--list] [--slow] [--stored] [--scratch FOLDER [--resume]]

`numbers.yaml` says what is stated where, and which command gives it. Commands run in a scratch folder, one after the
other, each once. Those that take hours run with --slow only; without it what they stored in `results` is compared. With
--stored nothing is run. Exits with 3 when a sentence does not hold or a command fails. Numbers that depend on the
machine are printed and not judged.
"""

import argparse
import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.claims import ROOT, Claim, NumbersFile, Run, Same, Value, read, read_numbers_file

UNRUN, FAILED = "not run", "failed"


@dataclass
class CommandRunner:
    """Runs commands, each once, and gives what they wrote.

    Parameters
    ----------
    numbers_file : all runs
    folder : to run in
    slow : also what takes hours
    stored : nothing at all
    resume : what ended in this folder before is not run again
    """

    numbers_file: NumbersFile
    folder: Path
    slow: bool = False
    stored: bool = False
    resume: bool = False
    texts: dict[str, str | None] = field(default_factory=dict)
    failed: dict[str, str] = field(default_factory=dict)
    absent: dict[Value, str] = field(default_factory=dict)

    def runs(self, run: Run) -> bool:
        """Whether a run is asked for."""
        return not self.stored and (self.slow or not run.slow)

    def text(self, name: str) -> str | None:
        """What a run wrote; None where it was not run, or failed."""
        if name not in self.texts:
            self.texts[name] = self._text(self.numbers_file.runs[name])
        return self.texts[name]

    def _text(self, run: Run) -> str | None:
        if not self.runs(run):
            return read(run.earlier) if run.earlier else None
        for needed in run.after:
            if self.text(needed) is None and needed in self.failed:
                self.failed[run.name] = f"{needed} failed"
                return None
        printed = self.folder / f"{run.name}.printed"
        if not (self.resume and printed.is_file()):
            outputs = []
            for command in run.commands:
                print(f"... {command}", end="", flush=True)
                began = time.perf_counter()
                ended = subprocess.run(
                    words_of(command), cwd=self.folder, env=environment(), capture_output=True, text=True, check=False
                )
                print(f"  ({time.perf_counter() - began:.0f} s)", flush=True)
                if ended.returncode:
                    last = (ended.stderr.strip().splitlines() or ["no message"])[-1]
                    self.failed[run.name] = f"{command}: exit code {ended.returncode}, {last}"
                    return None
                outputs.append(ended.stdout)
            printed.write_text("".join(outputs), encoding="utf-8")
        if not run.file:
            return printed.read_text(encoding="utf-8")
        path = (ROOT if run.within else self.folder) / run.file
        if not path.is_file():
            self.failed[run.name] = f"{run.commands[-1]}: no file {run.file}"
            return None
        return path.read_text(encoding="utf-8")


def words_of(command: str) -> list[str]:
    """Words of a command as documents have it, for this Python and from any folder."""
    words = [str(ROOT / word) if (ROOT / word).exists() and "/" in word else word for word in shlex.split(command)]
    programs = {"python": [sys.executable], "recon": [sys.executable, "-m", "recon"]}
    programs["phantomgen"] = [sys.executable, "-m", "phantomgen"]
    return [*programs.get(words[0], [words[0]]), *words[1:]]


def environment() -> dict[str, str]:
    """That of this process, with this checkout first among what Python imports."""
    path = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH", ""))))
    return {**os.environ, "PYTHONPATH": path}


def verdict(value: Value, runner: CommandRunner) -> tuple[str, str]:
    """What was measured, and what that says."""
    text = runner.text(value.run)
    if text is None:
        return "-", FAILED if value.run in runner.failed else UNRUN
    try:
        found = value.measured(text)
    except (LookupError, ValueError) as error:
        runner.absent[value] = str(error.args[0])
        return "absent", "no"
    if value.machine:
        return f"{found:.4g}", "machine"
    return f"{found:.4g}", "holds" if value.holds(found) else "no"


def selected(claims: Iterable[Claim], words: list[str]) -> list[Claim]:
    """Claims of which the document, the words or a run has one of some words."""
    return [c for c in claims if not words or any(w.lower() in key_of(c).lower() for w in words)]


def key_of(claim: Claim) -> str:
    return " ".join([claim.document, claim.words, *(value.run for value in claim.values)])


def short(words: str, width: int = 60) -> str:
    """The beginning of a sentence."""
    text = " ".join(words.split())
    return text if len(text) <= width else f"{text[: width - 3]}..."


def listing(claims: list[Claim], numbers_file: NumbersFile) -> None:
    """What is stated, and the commands that give it."""
    for claim in claims:
        stated = ", ".join(value.stated for value in claim.values)
        print(f"{claim.document}: {short(claim.words, 100)}\n    {stated}")
        for name in dict.fromkeys(value.run for value in claim.values):
            run = numbers_file.runs[name]
            print(f"    {'slow: ' if run.slow else ''}{'; '.join(run.commands)}")


def judged(claims: list[Claim], runner: CommandRunner) -> tuple[dict[Claim, list[str]], int]:
    """Prints every number; sentences that do not hold with what is wrong, and how many numbers were not looked at."""
    wrong: dict[Claim, list[str]] = {}
    unrun = 0
    lines = [f"{'document':<28}{'words':<62}{'stated':>10}{'measured':>12}  verdict"]
    for claim in claims:
        for value in claim.values:
            found, says = verdict(value, runner)
            lines.append(f"{claim.document:<28}{short(claim.words):<62}{value.stated:>10}{found:>12}  {says}")
            unrun += says == UNRUN
            if says in ("no", FAILED):
                reason = FAILED if says == FAILED else runner.absent.get(value, found)
                wrong.setdefault(claim, []).append(f"{value.stated}: {reason}")
    print("\n".join(lines))
    return wrong, unrun


def differing(entries: Iterable[Same], runner: CommandRunner) -> list[str]:
    """Lines of documents that are not those of the results any more."""
    found = []
    for entry in entries:
        text = runner.text(entry.run)
        if text is not None:
            found += [f"{entry.document}: {line}" for line in entry.missing(read(entry.document), text)]
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument(
        "--only", nargs="+", default=[], metavar="WORD", help="claims that have a word; not case-sensitive"
    )
    parser.add_argument("--list", action="store_true", help="say what there is, run nothing")
    parser.add_argument("--slow", action="store_true", help="run what takes hours, too, and store its results anew")
    parser.add_argument("--stored", action="store_true", help="run nothing; compare with stored results")
    parser.add_argument("--scratch", type=Path, help="folder for scans and runs, which is kept")
    parser.add_argument("--resume", action="store_true", help="do not repeat what ended in that folder")
    asked = parser.parse_args()
    numbers_file = read_numbers_file()
    claims = selected(numbers_file.all_claims(), asked.only)
    if asked.list:
        listing(claims, numbers_file)
        return 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = (asked.scratch or Path(temporary)).absolute()
        folder.mkdir(parents=True, exist_ok=True)
        runner = CommandRunner(numbers_file, folder, asked.slow, asked.stored, asked.resume)
        wrong, unrun = judged(claims, runner)
        differ = differing((s for s in numbers_file.same if not asked.only), runner)
    for name, why in runner.failed.items():
        print(f"failed: {name}: {why}")
    for claim, reasons in wrong.items():
        print(f"no longer holds: {claim.document}: {' '.join(claim.words.split())}\n    {'; '.join(reasons)}")
    for line in differ:
        print(f"not in the results: {line}")
    print(f"{len(claims)} sentences: {len(wrong) + len(differ)} do not hold; {unrun} numbers were not measured")
    return 3 if wrong or differ or runner.failed else 0


if __name__ == "__main__":
    sys.exit(main())
