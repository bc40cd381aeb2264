"""Which rule averages expected counts over pixels well enough, at the least cost: measured on parts of some views.

Where silhouettes pass, or nothing does, the yardstick is the same splitting with far more Gauss nodes, on all pixels of
the sampled windows. Where surfaces meet, or voxel maps lie, it is a regular grid of rays, on a sample of pixels. Both
share the energy nodes with what they judge, so that pixels are judged alone.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int, UInt8

from phantomgen.ops.expose import CROSSED, EMPTY, KINKED, RULES, VOXELS, Exposed, expose, expose_brute
from phantomgen.scene import Scan
from phantomgen.settings import Settings
from spectra.threads import run_parallel
from spectra.transmission import Transmission

FINEST = ((8, 6), (10, 8), (14, 10), (18, 12), (24, 16))
# From cheap to fine. A plain grid first, then silhouettes that are split.
GRIDS = (1, 2, 3, 4)
RULE_LADDER = (
    ((1, 1), (2, 1), (2, 2), (3, 2), (4, 3)),
    ((2, 1), (2, 2), (3, 2), (4, 3), (6, 4)),
    RULES,
    ((3, 2), (4, 3), (6, 4), (9, 6), (12, 8)),
    ((4, 3), (6, 4), (9, 6), (12, 8), (18, 12)),
)
VOXEL_LADDER = (1.0, 2.0, 4.0, 8.0, 16.0)
VIEWS = 3
_WINDOW = 48
_MOST_WINDOWS = 4
# Crossed pixels per view, and pixels per view and kind that are compared with a grid of rays.
_MOST_CROSSED = 1500
_BRUTE_PIXELS = 12
_BRUTE_RAYS = 256
_LEAST = 1e-12

Image = Float[np.ndarray, "channel row column"]
Frame = Float[np.ndarray, "4 3"]
Counts = Float[np.ndarray, "..."]


@dataclass(frozen=True)
class Trial:
    """A setting that was tried: what it is, its worst error of log counts, and its cost: rays per pixel, or nodes."""

    setting: str
    error: float
    cost: float


@dataclass(frozen=True)
class Choice:
    """The cheapest setting of a part that meets its share of the tolerance, or the finest one.

    Parameters
    ----------
    part : of the simulation
    setting : what was chosen
    error : worst error of log counts against a much finer computation
    share : of the tolerance
    trials : settings that were tried, the cheapest first
    """

    part: str
    setting: str
    error: float
    share: float
    trials: tuple[Trial, ...] = ()

    @property
    def met(self) -> bool:
        """Whether the error is no larger than wished."""
        return self.error <= self.share


@dataclass(frozen=True, eq=False)
class Window:
    """A part of a view, as a panel of its own.

    Parameters
    ----------
    frame : of the part
    size : rows and columns
    classes : of the pixels
    profile : lengths in the beam's profile, or None
    """

    frame: Frame
    size: tuple[int, int]
    classes: UInt8[np.ndarray, "row column"]
    profile: Float[np.ndarray, "part row column"] | None


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Windows of a scan, with the yardsticks for their pixels.

    Parameters
    ----------
    scan, transmission : what is computed
    windows : parts of views that hold edges
    finest : counts with `FINEST` rules, per window
    pixels, brute : pixels where surfaces meet or maps lie, and their counts from grids of rays, per window
    """

    scan: Scan
    transmission: Transmission
    windows: tuple[Window, ...]
    finest: tuple[Image, ...]
    pixels: tuple[Int[np.ndarray, "pixel 2"], ...]
    brute: tuple[Float[np.ndarray, "pixel channel"], ...]

    @classmethod
    def of(cls, scan: Scan, transmission: Transmission) -> "PixelSample":
        """Draw windows by the scan's seed, and compute their yardsticks."""
        rng = np.random.default_rng([scan.seed, 5])
        windows = windows_of(scan, transmission, rng)
        finest = run_parallel(
            lambda window: exposed(scan, transmission, window, Settings(rules=FINEST)).counts, windows
        )
        pixels = tuple(_hard_pixels(window, rng) for window in windows)
        brute = run_parallel(lambda job: _brute(scan, transmission, *job), list(zip(windows, pixels, strict=True)))
        return cls(scan, transmission, windows, tuple(finest), pixels, tuple(brute))

    def has(self, kind: int) -> bool:
        """Whether some sampled pixel is of a kind."""
        return any((window.classes == kind).any() for window in self.windows)

    def trial(self, name: str, settings: Settings) -> tuple[Trial, Trial, Trial]:
        """Worst errors with some settings: of pixels without hard kinds, of KINKED, of VOXELS pixels."""
        found = list(run_parallel(lambda w: exposed(self.scan, self.transmission, w, settings), self.windows))
        rays = sum(e.rays.sum() for e in found) / sum(w.classes.size for w in self.windows)
        errors = [max(kind, default=0.0) for kind in zip(*self._errors(found), strict=True)]
        return tuple(Trial(name, error, float(rays)) for error in errors)  # type: ignore[return-value]

    def _errors(self, found: list[Exposed]) -> Iterator[tuple[float, float, float]]:
        """Worst errors per window."""
        for window, exposed, finest, pixels, brute in zip(
            self.windows, found, self.finest, self.pixels, self.brute, strict=True
        ):
            easy = (window.classes != KINKED) & (window.classes != VOXELS)
            level = finest.max(axis=(1, 2), keepdims=True)
            at = exposed.counts[:, pixels[:, 0], pixels[:, 1]].T
            kinds = window.classes[pixels[:, 0], pixels[:, 1]]
            met, mapped = kinds == KINKED, kinds == VOXELS
            yield (
                worst_error(exposed.counts[:, easy], finest[:, easy], level[:, :, 0]),
                worst_error(at[met], brute[met], level[:, 0, 0]),
                worst_error(at[mapped], brute[mapped], level[:, 0, 0]),
            )


def choose_pixels(
    scan: Scan, transmission: Transmission, settings: Settings, share: float
) -> tuple[Settings, list[Choice]]:
    """The cheapest rules whose worst errors stay within `share`.

    Parameters
    ----------
    scan : what is simulated; where its scene says how many sub-rays it wants, that is only judged
    transmission : with the energy nodes that were chosen
    settings : to be completed
    share : of the tolerance, for log counts
    """
    sample = PixelSample.of(scan, transmission)
    if scan.sub_rays is not None:
        fixed = replace(settings, sub_rays=scan.sub_rays)
        trial = _worst_of(sample.trial(_grid_name(scan.sub_rays), fixed))
        return fixed, [Choice("pixels", f"{trial.setting}, as the scene says", trial.error, share, (trial,))]
    plain = [replace(settings, sub_rays=n) for n in GRIDS]
    tried: list[Trial] = []
    for n, candidate in zip(GRIDS, plain, strict=True):
        tried.append(_worst_of(sample.trial(_grid_name(n), candidate)))
        if tried[-1].error <= share:
            return candidate, [Choice("pixels", tried[-1].setting, tried[-1].error, share, tuple(tried))]
        if tried[-1].error > 20 * share:  # errors fall by less than that from one grid to the next
            break
    return _split(sample, settings, share, tuple(tried))


def _split(
    sample: PixelSample, settings: Settings, share: float, tried: tuple[Trial, ...]
) -> tuple[Settings, list[Choice]]:
    """The same with pixels split along silhouettes; other kinds of pixels have settings of their own."""
    settings, choice = _climb(
        "silhouettes", [(_rule_name(r), replace(settings, rules=r)) for r in RULE_LADDER], share, sample, 0, tried
    )
    choices = [choice]
    if sample.has(VOXELS):
        steps = [(f"{n:g} rays per voxel and side", replace(settings, rays_per_voxel=n)) for n in VOXEL_LADDER]
        settings, choice = _climb("voxel maps", steps, share, sample, 2)
        choices.append(choice)
    return settings, choices


def _climb(
    part: str,
    ladder: list[tuple[str, Settings]],
    share: float,
    sample: PixelSample,
    kind: int,
    tried: tuple[Trial, ...] = (),
) -> tuple[Settings, Choice]:
    """The first step of a ladder that meets the share, else the best one."""
    trials = list(tried)
    reached: list[tuple[Trial, Settings]] = []
    for name, settings in ladder:
        reached.append((sample.trial(name, settings)[kind], settings))
        trials.append(reached[-1][0])
        if trials[-1].error <= share:
            break
    trial, settings = reached[-1] if trials[-1].error <= share else min(reached, key=lambda step: step[0].error)
    return settings, Choice(part, trial.setting, trial.error, share, tuple(trials))


def windows_of(scan: Scan, transmission: Transmission, rng: np.random.Generator) -> tuple[Window, ...]:
    """Parts of some views that hold edges."""
    views = np.unique(np.linspace(0, len(scan.geometry) - 1, VIEWS).round().astype(int))
    return tuple(w for view in views for w in _windows(scan, transmission, int(view), rng))


def _windows(scan: Scan, transmission: Transmission, view: int, rng: np.random.Generator) -> Iterator[Window]:
    """Parts of a view around random edges; fewer where they hold many."""
    frame, panel = scan.geometry.ray_frames()[view], scan.geometry.panel
    whole = Window(frame, (panel.rows, panel.columns), np.empty((0, 0), np.uint8), _profile(scan))
    classes = exposed(scan, transmission, whole, Settings(sub_rays=2)).classes
    edges = np.argwhere(classes >= CROSSED)
    if not len(edges):
        edges = np.argwhere(classes > EMPTY)
    if not len(edges):
        return
    crossed = 0
    size = (min(_WINDOW, panel.rows), min(_WINDOW, panel.columns))
    for row, column in edges[rng.integers(len(edges), size=_MOST_WINDOWS)]:
        top = int(np.clip(row - size[0] // 2, 0, panel.rows - size[0]))
        left = int(np.clip(column - size[1] // 2, 0, panel.columns - size[1]))
        part = (slice(top, top + size[0]), slice(left, left + size[1]))
        shifted = frame.copy()
        shifted[1] += left * frame[2] + top * frame[3]
        profile = None if scan.profile is None else np.ascontiguousarray(scan.profile.lengths[:, *part])
        yield Window(shifted, size, classes[part], profile)
        crossed += int((classes[part] == CROSSED).sum())
        if crossed > _MOST_CROSSED:
            return


def exposed(scan: Scan, transmission: Transmission, window: Window, settings: Settings) -> Exposed:
    """Counts of a window."""
    return expose(
        window.frame,
        *window.size,
        scan.scene.solids,
        transmission.columns,
        transmission.weights,
        transmission.starts,
        scan.scene.background,
        profile=window.profile,
        **settings.pixels,
    )


def _profile(scan: Scan) -> Float[np.ndarray, "part row column"] | None:
    """Lengths of the beam's profile."""
    return None if scan.profile is None else scan.profile.lengths


def _hard_pixels(window: Window, rng: np.random.Generator) -> Int[np.ndarray, "pixel 2"]:
    """Some pixels where surfaces meet or maps lie."""
    found = [np.empty((0, 2), np.int64)]
    for kind in (KINKED, VOXELS):
        pixels = np.argwhere(window.classes == kind)
        found.append(pixels[rng.permutation(len(pixels))[:_BRUTE_PIXELS]])
    return np.concatenate(found)


def _brute(
    scan: Scan, transmission: Transmission, window: Window, pixels: Int[np.ndarray, "pixel 2"]
) -> Float[np.ndarray, "pixel channel"]:
    """Counts of pixels from a grid of rays."""
    if not len(pixels):
        return np.empty((0, len(transmission)))
    return expose_brute(
        window.frame,
        pixels,
        scan.scene.solids,
        transmission.columns,
        transmission.weights,
        transmission.starts,
        scan.scene.background,
        n=_BRUTE_RAYS,
        profile=window.profile,
    )


def worst_error(counts: Counts, exact: Counts, level: Counts) -> float:
    """Worst difference of log counts where anything is left to measure."""
    seen = (counts > _LEAST * level) & (exact > _LEAST * level)
    if not seen.any():
        return 0.0
    return float(np.abs(np.log(counts[seen] / exact[seen])).max())


def _worst_of(trials: tuple[Trial, ...]) -> Trial:
    """The trial of the kind of pixels that is worst."""
    return max(trials, key=lambda trial: trial.error)


def _grid_name(n: int) -> str:
    """A plain grid in words."""
    return "one ray through each pixel's centre" if n == 1 else f"{n} x {n} rays where edges pass"


def _rule_name(rules: tuple[tuple[int, int], ...]) -> str:
    """Rules in words."""
    (a, b), (c, d) = rules[0], rules[-1]
    return f"split, {a} x {b} to {c} x {d} nodes per part"
