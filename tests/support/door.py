"""The property that every input must have: a command does its work, or says in one sentence why it does not."""

import os
import resource
import signal
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from types import FrameType

from click import Group
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, settings

SECONDS = 60  # processor time of one command on a tiny scan; what takes longer hangs
WAITING = 10  # times as long by the clock, on a busy machine
MEMORY = 2 * 2**30  # bytes that one command may take beside what the process has


TRIES = int(
    os.environ.get("FUZZ", "0")
)  # inputs per test, by a seed, in `make fuzz`; 0 in the suite: a few, always the same
_CHECKS = (
    HealthCheck.too_slow,
    HealthCheck.data_too_large,
    HealthCheck.function_scoped_fixture,
    HealthCheck.filter_too_much,
)


def tries(few: int) -> settings:
    """Settings of a test that tries `few` inputs in the suite."""
    number = TRIES or few
    return settings(
        max_examples=number, derandomize=not TRIES, deadline=None, database=None, suppress_health_check=_CHECKS
    )


class TooSlow(BaseException):
    """No `Exception`, so that nothing between here and there catches it."""


@contextmanager
def limited(seconds: int = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Stop what runs too long, and refuse memory beyond the limit."""

    def late(number: int, frame: FrameType | None) -> None:
        raise TooSlow(f"not finished after {seconds} s")

    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        mapped = int(file.read().split()[0]) * resource.getpagesize()
    clocks = {signal.ITIMER_PROF: (signal.SIGPROF, seconds), signal.ITIMER_REAL: (signal.SIGALRM, WAITING * seconds)}
    handlers = {number: signal.signal(number, late) for number, _ in clocks.values()}
    for clock, (_, most) in clocks.items():
        signal.setitimer(clock, most)
    resource.setrlimit(resource.RLIMIT_AS, (mapped + memory, before[1]))
    try:
        yield
    finally:
        for clock, (number, _) in clocks.items():
            signal.setitimer(clock, 0)
            signal.signal(number, handlers[number])
        with suppress(ValueError):
            resource.setrlimit(resource.RLIMIT_AS, before)


def run(program: Group, *arguments: object) -> Result:
    """Run a command within the limits; fail unless it did its work or said one sentence."""
    words = [str(argument) for argument in arguments]
    with limited():
        result = CliRunner().invoke(program, words)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        trace = "".join(traceback.format_exception(result.exception))
        raise AssertionError(f"{words} ended in a traceback:\n{trace}")
    assert result.exit_code in {0, 1, 2, 3}, (words, result.exit_code, result.stderr)
    if result.exit_code == 1:
        errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
        assert len(errors) == 1, (words, result.stderr)
    assert "Traceback" not in result.stderr, (words, result.stderr)
    assert len(result.stderr) < 20_000, (words, result.stderr[:1000])
    return result
