"""What a simulation made, in words and numbers."""

from dataclasses import dataclass, field
from pathlib import Path
from textwrap import indent
from typing import Any

from phantomgen.simulation.checks.verification import MeasuredError
from phantomgen.simulation.planning.plan import Plan


@dataclass(frozen=True)
class Summary:
    """Summary of a simulation: dataset, time, plan and error.

    Parameters
    ----------
    path : the dataset
    shape : views, channels, rows, columns
    size : of the file [byte]
    seconds : wall time per stage
    plan : how finely it was computed, and the error of each part
    error : expected counts against brute force
    warnings : sentences about what the scan cuts off
    """

    path: Path
    shape: tuple[int, int, int, int]
    size: int
    seconds: dict[str, float]
    plan: Plan
    error: MeasuredError
    warnings: list[str] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return all numbers under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return {
            "path": str(self.path),
            "shape": list(self.shape),
            "bytes": self.size,
            "seconds": {**self.seconds, "total": sum(self.seconds.values())},
            "plan": self.plan.to_dict(),
            "error": self.error.to_dict(),
            "warnings": self.warnings,
        }

    @property
    def text(self) -> str:
        """Summary as text."""
        views, channels, rows, columns = self.shape
        stages = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in self.seconds.items())
        return "\n".join(
            [
                f"{self.path}: {views} views x {channels} channels x {rows} x {columns}, {self.size / 1e6:.1f} MB",
                f"time     {sum(self.seconds.values()):.1f} s: {stages}",
                f"plan     {indent(self.plan.text, ' ' * 9).strip()}",
                f"error    {self.error}",
                f"next     recon fit {self.path}",
            ]
        )
