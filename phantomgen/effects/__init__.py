"""What a real scan has beyond exposure and photon noise: one file for each effect, each off unless a scene asks for it.

Effects meet a frame in the order of physics: the tube's output, then what happens on the way to the panel, then what
the detector makes of it. `phantomgen.simulate_views` applies them; an effect that is off costs nothing.
"""

from dataclasses import dataclass

from phantomgen.effects.tube_output import TubeOutput

__all__ = ["Effects", "TubeOutput"]


@dataclass(frozen=True)
class Effects:
    """The effects of a scan; None where one is off.

    Parameters
    ----------
    tube_output : photons per view that vary
    """

    tube_output: TubeOutput | None = None
