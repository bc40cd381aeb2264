"""Report of `phantomgen plan`: the parts of a scan, how finely each is computed, and the cost."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from textwrap import indent
from typing import Any

from phantomgen.runtime.stopwatch import Stopwatch
from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.collisions import check_collisions
from phantomgen.simulation.checks.verification import MeasuredError, quick_check
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.planning.cost import Cost, expected_cost
from phantomgen.simulation.planning.make_plan import make_plan
from phantomgen.simulation.planning.plan import Plan


@dataclass(frozen=True, eq=False)
class PlanReport:
    """Plan of a scan, with its measured error and its cost.

    Parameters
    ----------
    scan : what is simulated
    plan : how finely
    error : of the counts, by the same check that `make` ends with
    cost : time, memory and file size
    """

    scan: Scan
    plan: Plan
    error: MeasuredError
    cost: Cost

    @classmethod
    def of(cls, scan: Scan, tolerance: float, on_stage: Callable[[str], None] = lambda name: None) -> "PlanReport":
        """Plan a scan and compute parts of it.

        Parameters
        ----------
        scan : what is simulated
        tolerance : worst error of log projections that is wanted
        on_stage : called with the name of each stage when it begins

        Returns
        -------
        the report
        """
        check_collisions(scan)
        watch = Stopwatch(on_stage)
        with watch("plan"):
            plan = make_plan(scan, tolerance)
        scan = plan.scan
        with watch("check"):
            error = quick_check(scan, plan.exposure.transmission, plan.settings)
        with watch("cost"):
            cost = expected_cost(Views(scan, plan.exposure, plan.settings))
        seconds = {"plan": watch.seconds["plan"], **cost.seconds, "check": watch.seconds["check"]}
        return cls(scan, plan, error, replace(cost, seconds=seconds))

    @property
    def effects(self) -> list[str]:
        """Names of the effects that are on."""
        return [f.name for f in fields(self.scan.effects) if getattr(self.scan.effects, f.name) is not None]

    def to_dict(self) -> dict[str, Any]:
        """Return all values under stable keys, for JSON.

        Returns
        -------
        the mapping
        """
        return {
            "name": self.scan.name,
            "shape": list(self._shape),
            "voxels": list(self.scan.grid.shape),
            "basis": list(self.scan.basis.names),
            "effects": self.effects,
            "plan": self.plan.to_dict(),
            "error": self.error.to_dict(),
            "cost": self.cost.to_dict(),
        }

    @property
    def text(self) -> str:
        """Report as text."""
        scan, (views, channels, rows, columns) = self.scan, self._shape
        orbit, basis = scan.geometry.kind, ", ".join(scan.basis.names)
        return "\n".join(
            [
                f"{scan.name}: {len(scan.scene.objects)} objects, {views} views ({orbit}) x {channels} channels x "
                f"{rows} x {columns} pixels, {' x '.join(map(str, scan.grid.shape))} voxels",
                f"basis   {basis}",
                f"effects {', '.join(self.effects) or 'none'}",
                f"errors  {indent(self.plan.text, ' ' * 8).strip()}",
                f"check   {str(self.error).replace(' ' * 9, ' ' * 8)}",
                self.cost.text,
            ]
        )

    @property
    def _shape(self) -> tuple[int, int, int, int]:
        """Views, channels, rows, columns."""
        panel = self.scan.geometry.panel
        return len(self.scan.geometry), len(self.scan.detector), panel.rows, panel.columns
