"""Choice of the rule that averages expected counts over pixels: accurate enough at the least cost.

Where silhouettes pass, or nothing does, the reference is the same splitting with several times as many Gauss nodes, on
all pixels of the sampled windows. Where surfaces meet, or voxel maps lie, it is a regular grid of rays, on a sample of
pixels. Both share the energy nodes with what they judge, so that pixels are judged alone.

The rules are measured on parts of some views.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from jaxtyping import Float, Int

from phantomgen.ops.expected_counts import INTERSECTED, VOXELS, ExpectedCounts, expected_counts_by_grid
from phantomgen.scene.scan import Scan
from phantomgen.simulation.checks.reference_rays import RayGrid, split_grid, worst_error
from phantomgen.simulation.forward_model.discretization import RULE_LADDER, Settings
from phantomgen.simulation.forward_model.expected_counts import spectrum_of
from phantomgen.simulation.planning.faint_objects import FaintObjects
from phantomgen.simulation.planning.plan import Choice, Trial
from phantomgen.simulation.planning.sample_windows import Frame, Window, exposed, windows_of
from spectra.threads import run_parallel
from spectra.transmission import Transmission

# Rays along each edge of a pixel, from cheap to fine.
GRIDS = (1, 2, 3, 4)
# A rule of `RULE_LADDER` is compared with the one so many steps on.
_FINER = 2
# Rays per voxel along each edge of a pixel, from cheap to fine.
VOXEL_LADDER = (1.0, 2.0, 4.0, 8.0, 16.0)
# Parts of the share that rectangles of a pixel where surfaces meet may err by, as they estimate it themselves.
INTERSECTION_LADDER = (1.0, 0.3, 0.1, 0.03)
# For faint objects alone, so many steps of these ladders are tried at most.
_FAINT_STEPS = 4
# Pixels of each kind and window that are compared with a grid of rays.
_BRUTE_PIXELS = 12
# Seed of the sample, apart from that of the noise, so that plans do not depend on it.
_SEED = 5


@dataclass(frozen=True, eq=False)
class PixelSample:
    """Windows of a scan, and grids of rays for pixels where surfaces meet or maps lie.

    Parameters
    ----------
    scan, transmission : what is computed
    windows : parts of views that hold edges
    grids : some such pixels, and grids of rays through them, per window
    known : what was computed of all windows before, by its settings
    """

    scan: Scan
    transmission: Transmission
    windows: tuple[Window, ...]
    grids: tuple[RayGrid, ...]
    known: dict[Settings, list[ExpectedCounts]] = field(default_factory=dict)

    @classmethod
    def of(cls, scan: Scan, transmission: Transmission) -> "PixelSample":
        """Draw windows, always by the same seed.

        Parameters
        ----------
        scan : what is computed
        transmission : path lengths to counts

        Returns
        -------
        the sample
        """
        rng = np.random.default_rng(_SEED)
        windows = windows_of(scan, transmission, rng)
        grids = tuple(
            RayGrid(_hard_pixels(window, rng), partial(_brute, scan, transmission, window)) for window in windows
        )
        return cls(scan, transmission, windows, grids)

    def has(self, kind: int) -> bool:
        """Return whether some sampled pixel is of a kind.

        Parameters
        ----------
        kind : kind of pixel

        Returns
        -------
        True where there is one
        """
        return any((window.classes == kind).any() for window in self.windows)

    def rays(self, settings: Settings) -> float:
        """Compute the mean number of rays per pixel.

        Parameters
        ----------
        settings : how finely the scan is computed

        Returns
        -------
        rays per pixel
        """
        return sum(e.rays.sum() for e in self._found(settings)) / max(sum(w.classes.size for w in self.windows), 1)

    def easy_error(self, settings: Settings, finer: Settings) -> float:
        """Compute the worst difference to finer settings, in pixels where no surfaces intersect and no maps lie.

        Parameters
        ----------
        settings : to be judged
        finer : settings to compare with

        Returns
        -------
        worst difference of log counts
        """
        worst = 0.0
        for window, found, fine in zip(self.windows, self._found(settings), self._found(finer), strict=True):
            easy = (window.classes != INTERSECTED) & (window.classes != VOXELS)
            level = fine.counts.max(axis=(1, 2), keepdims=True)[:, :, 0]
            worst = max(worst, worst_error(found.counts[:, easy], fine.counts[:, easy], level))
        return worst

    def hard_error(self, settings: Settings, kinds: tuple[int, ...], share: float) -> float:
        """Compute the worst difference to grids of rays, in pixels of some kinds.

        The grids are finer where the difference exceeds `share`.

        Parameters
        ----------
        settings : to be judged
        kinds : kinds of pixels
        share : error that is allowed

        Returns
        -------
        worst difference of log counts
        """
        worst = 0.0
        for window, found, grid in zip(self.windows, self._found(settings), self.grids, strict=True):
            chosen = np.isin(window.classes[grid.pixels[:, 0], grid.pixels[:, 1]], kinds)
            worst = max(worst, grid.worst(found.counts, chosen, found.counts.max(axis=(1, 2)), share))
        return worst

    def _found(self, settings: Settings) -> list[ExpectedCounts]:
        """Counts of all windows."""
        if settings not in self.known:
            task = partial(exposed, self.scan, self.transmission, settings=settings)
            self.known[settings] = list(run_parallel(task, self.windows))
        return self.known[settings]


def choose_pixels(
    scan: Scan, transmission: Transmission, settings: Settings, share: float, faint: FaintObjects
) -> tuple[Settings, list[Choice]]:
    """Choose the cheapest rules whose worst errors stay within `share` and within the signal of faint objects.

    Parameters
    ----------
    scan : what is simulated; where its scene says how many sub-rays it wants, that is only judged
    transmission : with the energy nodes that were chosen
    settings : to be completed
    share : of the tolerance, for log counts
    faint : objects whose own signal must stay correct

    Returns
    -------
    settings with these rules, and the choices
    """
    sample = PixelSample.of(scan, transmission)
    settings = replace(settings, intersections=INTERSECTION_LADDER[0] * share)
    if scan.sub_rays is not None:
        trial = _plain(sample, settings, scan.sub_rays, share)
        choice = Choice("pixels", f"{trial.setting}, as the scene says", trial.error, share, (trial,))
        return replace(settings, sub_rays=scan.sub_rays), [choice]
    tried: list[Trial] = []
    coarse, blamed = None, ""
    for n in GRIDS:
        tried.append(_plain(sample, settings, n, share))
        if tried[-1].error <= share:
            grid = replace(settings, sub_rays=n)
            choice = Choice("pixels", tried[-1].setting, tried[-1].error, share, tuple(tried), decided=blamed)
            if (missed := faint.missed(grid)) is None:
                return grid, [choice]
            coarse, blamed = coarse or (grid, [choice]), missed
        elif tried[-1].error > 20 * share:  # errors fall by less than that from one grid to the next
            break
    found, choices = _split(sample, settings, share, tuple(tried), faint)
    if coarse is not None:
        if not all(choice.met for choice in choices):
            return coarse
        choices[0] = replace(choices[0], decided=choices[0].decided or blamed)
    return found, choices


def _plain(sample: PixelSample, settings: Settings, n: int, share: float) -> Trial:
    """Error of a plain grid of rays in all kinds of pixels."""
    grid = replace(settings, sub_rays=n)
    error = max(sample.easy_error(grid, settings), sample.hard_error(grid, (INTERSECTED, VOXELS), share))
    name = "one ray through each pixel's centre" if n == 1 else f"{n} x {n} rays where edges pass"
    return Trial(name, error, sample.rays(grid))


def _split(
    sample: PixelSample, settings: Settings, share: float, tried: tuple[Trial, ...], faint: FaintObjects
) -> tuple[Settings, list[Choice]]:
    """Pixels split along silhouettes; other kinds of pixels have settings of their own."""
    choices: list[Choice] = []
    if sample.has(INTERSECTED):
        parts = [replace(settings, intersections=part * share) for part in INTERSECTION_LADDER]
        steps = [(f"rectangles halved until they err by {s.intersections:.1e}", s) for s in parts]
        settings, choice = _climb(
            "meeting surfaces",
            steps,
            share,
            sample,
            lambda i: sample.hard_error(parts[i], (INTERSECTED,), share),
            (),
            faint,
        )
        choices.append(choice)
    levels = [replace(settings, rules=rules) for rules in RULE_LADDER]
    steps = [(_rule_name(level.rules), level) for level in levels[:-_FINER]]
    settings, choice = _climb(
        "silhouettes", steps, share, sample, lambda i: sample.easy_error(levels[i], levels[i + _FINER]), tried, faint
    )
    choices.insert(0, choice)
    if sample.has(VOXELS):
        rays = [replace(settings, rays_per_voxel=n) for n in VOXEL_LADDER]
        steps = [(f"{s.rays_per_voxel:g} rays per voxel and side", s) for s in rays]
        settings, choice = _climb(
            "voxel maps", steps, share, sample, lambda i: sample.hard_error(rays[i], (VOXELS,), share)
        )
        choices.append(choice)
    return settings, choices


def _climb(
    part: str,
    steps: list[tuple[str, Settings]],
    share: float,
    sample: PixelSample,
    error_of: Callable[[int], float],
    tried: tuple[Trial, ...] = (),
    faint: FaintObjects | None = None,
) -> tuple[Settings, Choice]:
    """The first of some steps that meets the share and makes no faint object wrong.

    Where there is none, the first that meets the share, else the best one. Steps beyond `_FAINT_STEPS` are not taken
    for faint objects.
    """
    trials: list[Trial] = []
    first, blamed = None, ""
    for i, (name, settings) in enumerate(steps):
        trials.append(Trial(name, error_of(i), sample.rays(settings)))
        if trials[-1].error > share:
            continue
        first = i if first is None else first
        missed = faint.missed(settings) if faint is not None and i < max(_FAINT_STEPS, first + 1) else None
        if missed is None:
            first, blamed = (i, blamed) if i < _FAINT_STEPS else (first, "")
            break
        if i + 1 >= _FAINT_STEPS:
            blamed = ""
            break
        blamed = missed
    chosen = min(range(len(trials)), key=lambda i: trials[i].error) if first is None else first
    trial = trials[chosen]
    choice = Choice(part, trial.setting, trial.error, share, (*tried, *trials), of_pixels=True, decided=blamed)
    return steps[chosen][1], choice


def _hard_pixels(window: Window, rng: np.random.Generator) -> Int[np.ndarray, "pixel 2"]:
    """Some pixels where surfaces meet or maps lie."""
    found = [np.empty((0, 2), np.int64)]
    for kind in (INTERSECTED, VOXELS):
        pixels = np.argwhere(window.classes == kind)
        found.append(pixels[rng.permutation(len(pixels))[:_BRUTE_PIXELS]])
    return np.concatenate(found)


def _brute(
    scan: Scan, transmission: Transmission, window: Window, pixels: Int[np.ndarray, "pixel 2"], rays: int
) -> Float[np.ndarray, "pixel channel"]:
    """Counts of pixels from a grid of rays."""
    scan = scan.by_module.instant(window.view)
    scene, spectrum = scan.scene, spectrum_of(scan, transmission)._replace(profile=window.profile)

    def expose_part(frame: Frame, aperture: tuple[float, float], n: int) -> Float[np.ndarray, "pixel channel"]:
        return expected_counts_by_grid(frame, pixels, scene.solids, spectrum, scene.background, n, aperture)

    return split_grid(expose_part, window.frame, scan.aperture, rays)


def _rule_name(rules: tuple[tuple[int, int], ...]) -> str:
    """Rules in words."""
    (a, b), (c, d) = rules[0], rules[-1]
    return f"split, {a} x {b} to {c} x {d} nodes per part"
