"""Faint objects of a scan: their own signal is small, and an error that a tolerance allows may be large beside it.

An object's own signal is what it changes of log counts, compared with the same scan without it: the error of all else
cancels there, but where edges cross. Windows around the faintest objects tell how wrong that signal is.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from phantomgen.ops.expected_counts import CROSSED
from phantomgen.scene.scan import Scan
from phantomgen.simulation.forward_model.discretization import RULE_LADDER, Settings
from phantomgen.simulation.forward_model.sampled_rays import points_of
from phantomgen.simulation.planning.sample_windows import Window, around, exposed, whole
from spectra.transmission import Transmission

# An object is faint whose own signal, in log counts, is below this: there, the tolerance falls in proportion to it.
FAINT = 0.1
# Below this an object is no more than rounding.
_NOTHING = 1e-7
# Objects of a scene that are looked at, those of them that decide, and views and rays of each.
_MOST_OBJECTS, _MOST_FAINT, _VIEWS, _RAYS = 64, 3, 2, 12
# Surfaces of more triangles are not traced once more without an object.
_MOST_TRIANGLES = 100_000
_REFERENCE = Settings(rules=RULE_LADDER[4], intersections=1e-6)
# Seed of the sample, apart from that of the noise, so that plans do not depend on it.
_SEED = 9


@dataclass(frozen=True, eq=False)
class FaintObject:
    """Faint object, and parts of views around it.

    Parameters
    ----------
    number, name : of the object, and of its material
    signal : the largest change of log counts that it makes
    without : the scan without it
    windows : parts of views that its outline passes
    known : signal of the object in all windows, by settings
    """

    number: int
    name: str
    signal: float
    without: Scan
    windows: tuple[Window, ...]
    known: dict[Settings, list[np.ndarray]] = field(default_factory=dict)

    def signals(self, scan: Scan, transmission: Transmission, settings: Settings) -> list[np.ndarray]:
        """Compute the change of log counts that the object causes in each window.

        Parameters
        ----------
        scan : what is simulated
        transmission : path lengths to counts
        settings : how finely it is computed

        Returns
        -------
        changes of each window, (channel, row, column)
        """
        if settings not in self.known:
            pairs = [
                [exposed(s, transmission, window, settings).counts for s in (self.without, scan)]
                for window in self.windows
            ]
            self.known[settings] = [_log_ratio(bare, with_it) for bare, with_it in pairs]
        return self.known[settings]


@dataclass(frozen=True, eq=False)
class FaintObjects:
    """The faintest objects of a scan.

    Parameters
    ----------
    scan, transmission : what is computed
    part : of its own signal that an object may err by
    objects : those that are faint, and what it takes to judge them
    """

    scan: Scan
    transmission: Transmission
    part: float
    objects: tuple[FaintObject, ...]

    @classmethod
    def of(cls, scan: Scan, transmission: Transmission, tolerance: float) -> "FaintObjects":
        """Find the faintest objects; none where the tolerance allows an error as large as their signal.

        Parameters
        ----------
        scan : what is simulated
        transmission : path lengths to counts
        tolerance : worst error of log projections that is wanted

        Returns
        -------
        the objects
        """
        part, found = tolerance / FAINT, []
        scan = scan.instant(len(scan.geometry) // 2)  # objects that move are judged where they are then
        surfaces = scan.scene.solids.surfaces
        few = surfaces is None or len(surfaces.triangles) <= _MOST_TRIANGLES
        if part < 1 and few and len(scan.scene.objects) <= _MOST_OBJECTS:
            found = sorted(_signals(scan, transmission))
        picked = np.unique(np.linspace(0, len(found) - 1, min(len(found), _MOST_FAINT)).round().astype(int))
        objects = (_faint_object(scan, transmission, *found[i]) for i in picked)
        return cls(scan, transmission, part, tuple(o for o in objects if o.windows))

    def missed(self, settings: Settings) -> str | None:
        """Return the object with the largest error, where it exceeds `part` of the object's own signal.

        Parameters
        ----------
        settings : how finely the scan is computed

        Returns
        -------
        name of the object; None where all errors are smaller
        """
        worst, name = self.part, None
        for thing in self.objects:
            exact = thing.signals(self.scan, self.transmission, _REFERENCE)
            found = thing.signals(self.scan, self.transmission, settings)
            peak = max(np.abs(s).max() for s in exact)
            error = max(np.abs(a - b).max() for a, b in zip(found, exact, strict=True)) / max(peak, _NOTHING)
            if error > worst:
                worst, name = error, f"object {thing.number} ({thing.name}), of signal {thing.signal:.1e}"
        return name


def _signals(scan: Scan, transmission: Transmission) -> Iterator[tuple[float, int]]:
    """Own signal and number of each faint object, by rays through points of it."""
    views, modules = _views(scan), scan.geometry.panel.modules
    middles = scan.by_module.geometry[views * modules + modules // 2].ray_frames()
    for i, (shape, _) in enumerate(scan.scene.objects):
        points = points_of(shape, _RAYS)[0][:_RAYS]
        if not len(points):
            continue
        frames = np.repeat(middles, len(points), axis=0)
        targets = np.tile(points, (len(middles), 1))
        pixels = np.linalg.solve(np.moveaxis(frames[:, 1:], 1, 2), (targets - frames[:, 0])[:, :, None])[:, :, 0]
        front = pixels[:, 0] > 1e-6
        directions = (targets - frames[:, 0])[front] / pixels[front, :1]
        counts = []
        for one in (without(scan, i), scan):
            lengths = one.scene.path_lengths(frames[front, 0], directions)
            if scan.profile is not None:
                lengths = np.hstack([lengths, np.zeros((len(lengths), len(scan.profile.names)))])
            counts.append(transmission.expected(lengths))
        signal = float(np.abs(_log_ratio(*counts)).max(initial=0.0))
        if _NOTHING < signal < FAINT:
            yield signal, i


def _faint_object(scan: Scan, transmission: Transmission, signal: float, number: int) -> FaintObject:
    """An object with windows around its outline, or around a part of that where it is large."""
    shape, material = scan.scene.objects[number]
    alone = replace(scan, scene=replace(scan.scene, objects=((shape, material),)))
    rng, windows, modules, flat = np.random.default_rng(_SEED), [], scan.geometry.panel.modules, scan.by_module
    for view in _views(scan):
        numbers = range(view * modules, (view + 1) * modules)
        seen = {n: exposed(alone, transmission, whole(flat, n), Settings(sub_rays=2)).classes for n in numbers}
        best = max(numbers, key=lambda n: (seen[n] >= CROSSED).sum())
        classes = seen[best]
        edges = np.argwhere(classes >= CROSSED)
        if len(edges):
            middle = edges.mean(axis=0).round().astype(int)
            window = around(flat, best, classes, *middle.tolist())
            if not (window.classes >= CROSSED).any():
                window = around(flat, best, classes, *edges[rng.integers(len(edges))].tolist())
            windows.append(window)
    indices = material if isinstance(material, tuple) else (material,)
    name = ", ".join(scan.scene.materials[i].name for i in indices)
    return FaintObject(number, name, signal, without(scan, number), tuple(windows))


def without(scan: Scan, number: int) -> Scan:
    """Remove an object from a scan.

    Parameters
    ----------
    scan : what is simulated
    number : index of the object

    Returns
    -------
    the scan without it
    """
    objects = scan.scene.objects
    return replace(scan, scene=replace(scan.scene, objects=objects[:number] + objects[number + 1 :]))


def _views(scan: Scan) -> np.ndarray:
    """Some views, spread over the scan."""
    return np.unique(np.linspace(0, 0.3 * (len(scan.geometry) - 1), _VIEWS).round().astype(int))


def _log_ratio(bare: Float[np.ndarray, "..."], seen: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """log(bare / seen), 0 where nothing is left."""
    lit = (bare > 0) & (seen > 0)
    return np.log(np.divide(bare, seen, out=np.ones_like(bare), where=lit))
