"""The figure of an edge search: profile likelihoods over energy."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from phantomgen.display.figures.style import BASIS_LINES, GRAY, figure_file, write_csv
from recon.kedge.profile_likelihood import EdgeProfile


def edge_profiles(profiles: Sequence[tuple[str, EdgeProfile]], thresholds: Sequence[float], path: Path) -> Path:
    """Deviance per ray above that of the likeliest edge, over the energy of the edge; and its surroundings, summed.

    The line on the right is the parabola of the width that is stated, the points are what was computed.

    Parameters
    ----------
    profiles : name and profile of each edge
    thresholds : energies where a channel begins or ends [keV]
    path : of the PNG; the curves are written beside it as CSV
    """
    with figure_file(path, (7.0, 3.0)) as figure:
        whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
        highest = 0.0  # without the few energies at which the fit of a ray did not converge
        for (name, profile), (colour, style) in zip(profiles, BASIS_LINES * len(profiles), strict=False):
            above = profile.peak - profile.saved
            whole.plot(
                profile.energy, above / max(profile.rays, 1), color=colour, linestyle=style, label=_label(profile)
            )
            highest = max(highest, float(np.quantile(above, 0.9)) / max(profile.rays, 1))
            reach = _reach(profile)
            near = np.abs(profile.energy - profile.best) <= reach
            close.plot(profile.energy[near] - profile.best, above[near], "o", color=colour, markersize=3)
            beside = np.linspace(-reach, reach, 201)
            width = np.where(beside < 0, profile.best - profile.low, profile.high - profile.best)
            close.plot(beside, (beside / width) ** 2, color=colour, linestyle=style, linewidth=0.8)
            close.axvspan(profile.low - profile.best, profile.high - profile.best, color=colour, alpha=0.15)
            write_csv(path.with_name(f"{path.stem}_{name}.csv"), {"energy_keV": profile.energy, "deviance": above})
        for threshold in thresholds:
            whole.axvline(threshold, color=GRAY, linewidth=0.6, zorder=0)
        whole.set(xlabel="energy of the edge [keV]", ylabel="deviance per ray above the least")
        whole.set_ylim(0, 1.2 * highest or None)
        whole.legend()
        close.axhline(1, color=GRAY, linewidth=0.6)
        close.set(xlabel="distance from the likeliest energy [keV]", ylabel="deviance above the least", ylim=(0, 5))
    return path


def _label(profile: EdgeProfile) -> str:
    return f"{profile.best:.2f} keV ± {profile.sigma:.2g}"


def _reach(profile: EdgeProfile) -> float:
    """How far the right panel shows a profile [keV]: 2.2 times its width, or the points beside the best."""
    beside = np.sort(np.abs(profile.energy - profile.best))[: min(3, len(profile.energy))]
    return max(2.2 * profile.sigma, float(beside[-1]))
