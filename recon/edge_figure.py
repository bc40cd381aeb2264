"""The figure of an edge search: profile likelihoods over energy."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recon.edge_profile import EdgeProfile
from recon.figure_style import BASIS_LINES, GRAY, figure_file, write_csv


def edge_profiles(profiles: Sequence[tuple[str, EdgeProfile]], thresholds: Sequence[float], path: Path) -> Path:
    """Deviance per ray above that of the likeliest edge, over the energy of the edge; and its surroundings, summed.

    Parameters
    ----------
    profiles : name and profile of each edge
    thresholds : energies where a channel begins or ends [keV]
    path : of the PNG; the curves are written beside it as CSV
    """
    with figure_file(path, (7.0, 3.0)) as figure:
        whole, close = figure.subplots(1, 2, width_ratios=(3, 2))
        for (name, profile), (colour, style) in zip(profiles, BASIS_LINES * len(profiles), strict=False):
            above = profile.peak - profile.saved
            whole.plot(
                profile.energy, above / max(profile.rays, 1), color=colour, linestyle=style, label=_label(profile)
            )
            near = np.abs(profile.energy - profile.best) <= _reach(profile)
            close.plot(profile.energy[near] - profile.best, above[near], "o-", color=colour, markersize=3)
            close.axvspan(profile.low - profile.best, profile.high - profile.best, color=colour, alpha=0.15)
            write_csv(path.with_name(f"{path.stem}_{name}.csv"), {"energy_keV": profile.energy, "deviance": above})
        for threshold in thresholds:
            whole.axvline(threshold, color=GRAY, linewidth=0.6, zorder=0)
        whole.set(xlabel="energy of the edge [keV]", ylabel="deviance per ray above the least", ylim=(0, None))
        whole.legend()
        close.axhline(1, color=GRAY, linewidth=0.6)
        close.set(xlabel="distance from the likeliest energy [keV]", ylabel="deviance above the least", ylim=(0, 10))
    return path


def _label(profile: EdgeProfile) -> str:
    return f"{profile.best:.2f} keV ± {profile.sigma:.2g}"


def _reach(profile: EdgeProfile) -> float:
    """How far the right panel shows a profile [keV]: to twice its width, and at least the points beside the best."""
    beside = np.sort(np.abs(profile.energy - profile.best))[: min(3, len(profile.energy))]
    return max(2 * profile.sigma, float(beside[-1]))
