"""The detector of a scene."""

from math import ceil
from pathlib import Path

from phantomgen.geometry.config import panel_of
from phantomgen.scene import schema
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.input_files.response_matrix import read_response
from phantomgen.scene.source import composition_name
from spectra.detector.dead_time import DeadTime
from spectra.detector.detector import AnyDetector, Detector
from spectra.detector.pulse_height import ChargeSharing, PulseHeightDetector
from spectra.detector.scintillator import SCINTILLATORS, EnergyIntegrating
from spectra.errors import InputError
from spectra.materials.material import Material
from spectra.source.source import Source

# A sensor's pixel is that of the panel in spite of rounding errors, no unit.
_ROUNDING = 1 - 1e-6
# Channels that count less than this part of the photons see none.
_LEAST = 1e-12


def scene_detector(file: SceneFile, source: Source) -> AnyDetector:
    """Create the detector of a scene; its last channel ends at the highest energy of the source.

    Parameters
    ----------
    file : the scene file
    source : the source of the scene

    Returns
    -------
    the detector

    Raises
    ------
    SceneError
        Where a channel is empty or sees no photons, or a sensor is impossible.
    """
    with file.at("detector"):
        detector = _detector(file, source)
        _check_seen(detector, source)
        return detector


def scene_dead_time(file: SceneFile) -> DeadTime | None:
    """Create the dead-time model of the detector's pixels.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    the model; None where every event is recorded

    Raises
    ------
    SceneError
        Where the scene has several sources.
    """
    model = getattr(file.model.detector, "dead_time", None)
    if model is not None and isinstance(file.model.source, schema.MultiSourceModel):
        raise file.error(("detector", "dead_time"), "is known for a single source only, got several")
    return None if model is None else DeadTime(model.tau_ns, model.exposure_ms, model.model)


def has_pile_up(file: SceneFile) -> bool:
    """Return whether the heights of pulses add while a pixel is busy.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    True for counts of summed energies, False where later pulses are only lost

    Raises
    ------
    SceneError
        Where pixels have no dead time.
    """
    if not getattr(file.model.detector, "pile_up", False):
        return False
    if getattr(file.model.detector, "dead_time", None) is None:
        raise file.error(("detector", "pile_up"), "needs detector.dead_time, in which pulses pile up")
    return True


def has_cumulative_counters(file: SceneFile) -> bool:
    """Return whether each counter of the detector counts all photons above its threshold.

    Parameters
    ----------
    file : the scene file

    Returns
    -------
    True for counts above thresholds, False for counts between them

    Raises
    ------
    SceneError
        Where the scene has several sources.
    """
    if getattr(file.model.detector, "counters", "bins") == "bins":
        return False
    if isinstance(file.model.source, schema.MultiSourceModel):
        raise file.error(("detector", "counters"), "may be cumulative with a single source only, got several")
    return True


def _detector(file: SceneFile, source: Source) -> AnyDetector:
    """The detector by its type."""
    model = file.model.detector
    if isinstance(model, schema.EnergyIntegratingModel):
        return _energy_integrating(model, source)
    if isinstance(model, schema.ResponseMatrixModel):
        return read_response(model, Path(file.name).parent, source.maximum)
    return _photon_counting(file, model, source)


def _check_seen(detector: AnyDetector, source: Source) -> None:
    """Refuse channels without photons; ideal channels of a single energy may be blind, as all but one are."""
    if source.is_monochromatic and type(detector) is Detector:
        return
    width = max(source.maximum - detector.lowest, 1.0)
    energies, photons = source.sampled(source.grid(detector.lowest, ceil(width), detector.breaks))
    counts = (photons * detector.response(energies)).sum(axis=1)
    for channel, level in zip(detector.channels, counts, strict=True):
        if level <= _LEAST * source.photons:
            raise InputError(
                f"channel {channel.name} [{channel.lower:g}, {channel.upper:g}] keV sees no photons of a source that "
                f"ends at {source.maximum:g} keV"
            )


def _photon_counting(file: SceneFile, model: schema.PhotonCountingModel, source: Source) -> AnyDetector:
    """An ideal detector, or one whose pulses are not as high as the photon's energy."""
    sensor = Material(composition_name(model.composition), model.density, model.composition)
    with file.at("detector", "thresholds"):
        ideal = Detector.photon_counting(model.thresholds, source.maximum, sensor, model.thickness)
    if not (model.resolution or model.fluorescence or model.charge_sharing or model.compton):
        return ideal
    shared = model.charge_sharing
    sharing = (
        None if shared is None else ChargeSharing(shared.pitch, shared.cloud, _with_covariance(file, model, shared))
    )
    effects = model.resolution, model.fluorescence, sharing, model.compton
    return PulseHeightDetector(ideal.channels, sensor, model.thickness, *effects)


def _with_covariance(file: SceneFile, model: schema.PhotonCountingModel, shared: schema.ChargeSharingModel) -> bool:
    """Whether counts of neighbouring pixels are drawn together."""
    several = isinstance(file.model.source, schema.MultiSourceModel)
    if model.dead_time is not None or several or model.compton:
        if shared.covariance:
            what = "several sources" if several else "Compton scattering" if model.compton else "dead time"
            raise file.error(("detector", "charge_sharing", "covariance"), f"is not known for a detector with {what}")
        return False
    panel = panel_of(file.model.panel)
    pitch = min(panel.row_pitch, panel.column_pitch)
    if shared.pitch * _ROUNDING <= pitch:
        return shared.covariance is not False
    if shared.covariance:
        raise file.error(
            ("detector", "charge_sharing", "pitch"),
            f"of the sensor, {shared.pitch:g} mm, must not be larger than that of the panel, {pitch:g} mm",
        )
    return False


def _energy_integrating(model: schema.EnergyIntegratingModel, source: Source) -> AnyDetector:
    """A scintillator; the usual ones by name, with their usual density and thickness."""
    name = composition_name(model.composition)
    usual = SCINTILLATORS.get(name)
    if usual is None:
        return EnergyIntegrating.behind(source, Material(name, model.density, model.composition), model.thickness)
    density = usual.density if model.density is None else model.density
    thickness = usual.thickness if model.thickness is None else model.thickness
    return EnergyIntegrating.behind(source, Material(name, density, usual.composition), thickness)
