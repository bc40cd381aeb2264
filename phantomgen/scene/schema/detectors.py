"""Detectors in a scene file. Energies in keV, lengths in mm."""

from typing import Annotated, Literal

from pydantic import Field, PositiveFloat

from phantomgen.scene.schema.base import Composition, Model, NonNegative


class ChargeSharingModel(Model):
    """Pixels of the sensor itself: pitch, and the standard deviation of a charge cloud [mm].

    Counts of neighbouring pixels are drawn with their covariance, unless there is dead time or several sources.
    """

    pitch: PositiveFloat
    cloud: NonNegative
    covariance: bool | None = None


class DeadTimeModel(Model):
    """Counts lost because a pixel is busy: dead time [ns], exposure of one view [ms], and the kind of counter."""

    tau_ns: PositiveFloat
    exposure_ms: PositiveFloat
    model: Literal["nonparalyzable", "paralyzable"] = "nonparalyzable"


class PhotonCountingModel(Model):
    """A photon-counting detector; a channel reaches from its threshold to the next.

    It is ideal unless it has a resolution (full width at half maximum [keV]), fluorescence, shared charge, or Compton
    scattering in the sensor, which matters for silicon. With `pile_up`, pulses in one dead time add to one count of
    their summed energy. Its dataset has the counts between thresholds (`bins`), or those above each of them
    (`cumulative`).
    """

    type: Literal["photon_counting"]
    thresholds: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    composition: Composition = "CdTe"
    density: PositiveFloat | None = None
    thickness: PositiveFloat = 1.6
    resolution: NonNegative = 0.0
    fluorescence: bool = False
    charge_sharing: ChargeSharingModel | None = None
    compton: bool = False
    dead_time: DeadTimeModel | None = None
    pile_up: bool = False
    counters: Literal["bins", "cumulative"] = "bins"


class AxisModel(Model):
    """Evenly spaced energies [keV]."""

    first: NonNegative
    step: PositiveFloat


class ResponseMatrixModel(Model):
    """Counters by a table of counts per incident photon: a CSV or .npy file, or a dataset such as file.h5:/path.

    Rows are energies of incident photons, columns channels or bins of deposited energy. A CSV file has the energies in
    its first column, and names of channels, or the middles of bins, in its first line; for arrays `energies` and
    `deposited` give both. Deposited energies are counted `per` bin or keV. Relative paths start at the folder of the
    scene file.
    """

    type: Literal["response_matrix"]
    file: str
    columns: Literal["channels", "deposited"]
    thresholds: Annotated[tuple[PositiveFloat, ...], Field(min_length=1)]
    energies: AxisModel | None = None
    deposited: AxisModel | None = None
    per: Literal["bin", "keV"] | None = None
    dead_time: DeadTimeModel | None = None


class EnergyIntegratingModel(Model):
    """A scintillator that sums up the energies of the photons it absorbs, in one channel [keV].

    The composition is CsI, GOS, GOS screen or CdWO4, with nominal density and thickness where these are left out; or
    any other with density [g/cm^3] and thickness [mm].
    """

    type: Literal["energy_integrating"]
    composition: Composition = "CsI"
    density: PositiveFloat | None = None
    thickness: PositiveFloat | None = None


DetectorModel = Annotated[
    PhotonCountingModel | EnergyIntegratingModel | ResponseMatrixModel, Field(discriminator="type")
]
