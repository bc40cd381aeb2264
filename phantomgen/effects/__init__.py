"""Effects of a real scan beyond exposure and photon noise: one file for each effect, each off by default.

Effects meet a frame in the order of physics: the tube's output, then what happens on the way to the panel, then what
the detector makes of it. `phantomgen.simulation.forward_model.frames` applies them; an effect that is off costs
nothing.
"""

from dataclasses import dataclass

from phantomgen.effects.aperture import Aperture
from phantomgen.effects.blur import Blur
from phantomgen.effects.defects import Defects
from phantomgen.effects.electronic_noise import ElectronicNoise
from phantomgen.effects.focal_spot import FocalSpot
from phantomgen.effects.grid import AntiScatterGrid
from phantomgen.effects.lag import Lag
from phantomgen.effects.pixel_gain import Gain
from phantomgen.effects.scatter import ComptonScatter, ScatterKernel
from phantomgen.effects.tube_fluctuation import TubeOutput

__all__ = [
    "AntiScatterGrid",
    "Aperture",
    "Blur",
    "ComptonScatter",
    "Defects",
    "Effects",
    "ElectronicNoise",
    "FocalSpot",
    "Gain",
    "Lag",
    "ScatterKernel",
    "TubeOutput",
]


@dataclass(frozen=True)
class Effects:
    """Effects of a scan; None where one is off.

    Parameters
    ----------
    tube_output : photons per view that vary
    focal_spot : points that photons start from
    aperture : the part of each pixel that is sensitive
    scatter : photons that an object scatters onto the panel
    grid : in front of the panel, which absorbs most of them
    blur : of the detector
    gain : sensitivity that differs between pixels
    lag : afterglow in later views
    electronics : noise and offset of readings
    defects : dead and hot pixels
    """

    tube_output: TubeOutput | None = None
    focal_spot: FocalSpot | None = None
    aperture: Aperture | None = None
    scatter: ScatterKernel | ComptonScatter | None = None
    grid: AntiScatterGrid | None = None
    blur: Blur | None = None
    gain: Gain | None = None
    lag: Lag | None = None
    electronics: ElectronicNoise | None = None
    defects: Defects | None = None
