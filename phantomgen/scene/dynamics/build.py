"""The time of a scene file: signals, materials that change, and phases."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from phantomgen.scene import schema
from phantomgen.scene.dynamics.dynamics import Dynamics, Inflow, Phases
from phantomgen.scene.dynamics.object_motion import Motions
from phantomgen.scene.dynamics.signals import Cardiac, GammaVariate, Respiratory, Signal, Sine, Table
from phantomgen.scene.file.scene_file import SceneFile, closest

# Signals are tried at so many times of the scan.
_TRIED = 1001


def scene_dynamics(
    file: SceneFile,
    times: Float[np.ndarray, " view"],
    train: Int[np.ndarray, " train"],
    motions: tuple[Motions, ...],
    materials: Sequence[str],
) -> Dynamics | None:
    """Create the time of a scene.

    Parameters
    ----------
    file : the scene file
    times : of the views, from 0 to 1
    train : numbers of the training views
    motions : of each object
    materials : names of the materials, in the order of their indices

    Returns
    -------
    the time; None where the scene has none

    Raises
    ------
    SceneError
        Where a signal is unknown or impossible, where a deformation folds space, where an inflow leaves the range from
        0 to 1, or where views are divided by a signal that does not repeat.
    """
    model = file.model.time
    if model is None:
        return None
    signals = {}
    for number, (name, signal) in enumerate(model.signals.items()):
        with file.at("time", "signals", name):
            signals[name] = _signal(signal, file.model.seed + number)
    dynamics = Dynamics(
        times=times * model.duration,
        duration=model.duration,
        signals=signals,
        motions=motions,
        inflows=tuple(_inflows(file, signals, materials, model.duration)),
        phases=None if model.phases is None else _phases(file, model.phases, signals),
        exposure=model.exposure,
    )
    with file.at("objects"):
        _check_folds(dynamics)
    lacking = _empty_phases(dynamics, train)
    if lacking and dynamics.phases is not None:
        raise file.error(
            ("time", "phases", "count"),
            f"{len(lacking)} of {dynamics.phases.count} phases hold no training view, the first is phase {lacking[0]}: "
            "give fewer phases or more views",
        )
    return dynamics


def _signal(model: schema.SignalModel, seed: int) -> Signal:
    """A signal."""
    match model:
        case schema.SineSignalModel():
            return Sine(period=model.period, start=model.start)
        case schema.RespiratorySignalModel():
            deviations = model.period_deviation, model.amplitude_deviation
            return Respiratory(model.period, model.exponent, model.start, *deviations, seed)
        case schema.CardiacSignalModel():
            parts = {"systole": model.systole, "relaxation": model.relaxation}
            return Cardiac(period=model.period, start=model.start, **parts)
        case schema.GammaVariateSignalModel():
            return GammaVariate(model.arrival, model.rise, model.shape)
        case schema.TableSignalModel():
            return Table(model.times, model.values, model.period)


def _inflows(file: SceneFile, signals: dict[str, Signal], materials: Sequence[str], duration: float) -> list[Inflow]:
    """Materials of objects that change."""
    found, times = [], np.linspace(0.0, duration, _TRIED)
    for name, model in file.model.materials.items():
        inflow = model.inflow
        if inflow is None or name not in materials:
            continue
        place = ("materials", name, "inflow", "signal")
        if inflow.signal not in signals:
            raise file.error(place, f"there is no signal {inflow.signal!r}{closest(inflow.signal, signals)}")
        values = signals[inflow.signal].values(times)
        if values.min() < -1e-9 or values.max() > 1 + 1e-9:
            worst = values.min() if values.min() < 0 else values.max()
            raise file.error(
                place, f"an inflow follows a signal from 0 to 1, but {inflow.signal!r} reaches {worst:.3g}"
            )
        found.append(Inflow(materials.index(name), materials.index(inflow.peak), inflow.signal))
    return found


def _phases(file: SceneFile, model: schema.PhasesModel, signals: dict[str, Signal]) -> Phases:
    """The division of the views."""
    if model.signal is not None:
        place = ("time", "phases", "signal")
        if model.signal not in signals:
            raise file.error(place, f"there is no signal {model.signal!r}{closest(model.signal, signals)}")
        if signals[model.signal].cycles(np.zeros(1)) is None:
            raise file.error(place, f"signal {model.signal!r} does not repeat: leave it out to divide the time")
    return Phases(model.count, model.signal)


def _check_folds(dynamics: Dynamics) -> None:
    """Refuse deformations that fold space at some time of the scan."""
    tried = np.linspace(0.0, dynamics.duration, _TRIED)
    for motion in {id(motion.lattice): motion for motions in dynamics.motions for motion in motions}.values():
        values = dynamics.signals[motion.signal].values(tried)
        for value in (values.min(), values.max()):
            motion.check_folds(float(value))


def _empty_phases(dynamics: Dynamics, train: Int[np.ndarray, " train"]) -> list[int]:
    """Numbers of the phases that hold no training view."""
    phase = dynamics.phase_of_view
    if phase is None or dynamics.phases is None:
        return []
    return sorted(set(range(dynamics.phases.count)) - set(phase[train].tolist()))
