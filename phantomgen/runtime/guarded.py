"""Guards for steps after a fit, such as scores and figures: their failure becomes a warning of one sentence."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable


@runtime_checkable
class Guard(Protocol):
    """Interface of a guard, which runs a block of code that may fail."""

    def __call__(self, what: str) -> AbstractContextManager[None]:
        """Guard a block; `what` names what it makes."""
        ...


class WarnOnFailure:
    """Guard that turns the failure of a block of code into a warning, and continues after it.

    Parameters
    ----------
    warn : gets the sentence and the error

    Attributes
    ----------
    failed : what was not made, and why, in the order of failures

    Notes
    -----
    An interruption by Ctrl-C passes.
    """

    def __init__(self, warn: Callable[[str, Exception], None]) -> None:
        self._warn = warn
        self.failed: dict[str, str] = {}

    @contextmanager
    def __call__(self, what: str) -> Iterator[None]:
        """Guard a block that makes `what`."""
        try:
            yield
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            self.failed[what] = reason
            self._warn(f"{what} failed ({reason}); the model and its volumes are written", error)


@contextmanager
def unguarded(what: str) -> Iterator[None]:
    """Run a block without a guard: errors pass.

    Parameters
    ----------
    what : name of the block, not used

    Yields
    ------
    nothing
    """
    yield
