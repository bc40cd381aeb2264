"""Callbacks of a fit: a progress bar, and an early stop."""

from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from recon.gaussians.optimize import Progress
from spectra.errors import InputError


class ProgressBar:
    """A progress bar on stderr, or a widget in notebooks; it shows the deviance over that of noise alone."""

    def __init__(self) -> None:
        self._bar: Any = None

    def on_step(self, progress: Progress) -> None:
        """Move the bar.

        Parameters
        ----------
        progress : what the fit tells after a step
        """
        if self._bar is not None and self._bar.total != progress.steps:  # the fit has begun anew
            self._bar.close()
            self._bar = None
        if self._bar is None:
            from tqdm.auto import tqdm  # noqa: PLC0415 - only where a bar is wanted

            self._bar = tqdm(total=progress.steps, unit="step")
        self._bar.update(progress.step - self._bar.n)
        self._bar.set_postfix({"deviance / noise": f"{progress.deviance:.3f}"}, refresh=False)

    def on_end(self, fit: Any) -> None:
        """Close the bar.

        Parameters
        ----------
        fit : the finished fit
        """
        if self._bar is not None:
            self._bar.close()


@dataclass
class EarlyStop:
    """End a fit when the mean deviance of its last steps no longer falls.

    Parameters
    ----------
    patience : number of steps; their mean deviance is compared with that of as many steps before
    change : smallest part by which the mean must fall
    after : part of all steps before which no fit ends, as the deviance may rise while steps are long

    Raises
    ------
    InputError
        When the patience is no positive whole number, the change is negative, or the part is not one from 0 to 1.
    """

    patience: int = 20
    change: float = 1e-3
    after: float = 0.5
    _deviances: list[float] = field(default_factory=list, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.patience, int) or self.patience < 1:
            raise InputError(f"the patience of an early stop is a whole number of steps, got {self.patience!r}")
        if not (isfinite(self.change) and self.change >= 0):
            raise InputError(f"the change of an early stop must be finite and not negative, got {self.change!r}")
        if not 0 <= self.after <= 1:
            raise InputError(f"an early stop counts after a part of the steps from 0 to 1, got {self.after!r}")

    def on_step(self, progress: Progress) -> bool:
        """Return whether the fit has stopped improving.

        Parameters
        ----------
        progress : what the fit tells after a step

        Returns
        -------
        True to end the fit
        """
        if progress.step == 1:
            self._deviances.clear()
        self._deviances.append(progress.deviance)
        if len(self._deviances) < 2 * self.patience or progress.step < self.after * progress.steps:
            return False
        last, before = self._deviances[-self.patience :], self._deviances[-2 * self.patience : -self.patience]
        return sum(last) > (1 - self.change) * sum(before)
