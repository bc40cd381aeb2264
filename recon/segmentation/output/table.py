"""Table of the materials, as text and for JSON."""

from typing import Any

import numpy as np

from recon.segmentation.result import Cluster, Segmentation
from recon.segmentation.scoring.scores import numbers_of


def record(segmentation: Segmentation, scores: dict[str, Any] | None) -> dict[str, Any]:
    """Collect everything but the volumes, for JSON.

    Parameters
    ----------
    segmentation : material maps
    scores : scores against the truth; None where there is none

    Returns
    -------
    options, materials and scores
    """
    s, options = segmentation, segmentation.options
    return {
        "domain": options.domain,
        "features": options.features,
        "bandwidth": options.bandwidth,
        "energies_keV": list(options.energies),
        "basis": list(s.subject.basis.names),
        "materials": [
            {
                "label": i + 1,
                "name": c.name,
                "rgb": [round(float(v), 4) for v in c.colour],
                "gaussians": None if s.gaussian_labels is None else int((s.gaussian_labels == i).sum()),
                "density": float(c.features[0]),
                "kappa": float(c.features[1]),
                "kedge_parts": c.features[2:].tolist(),
                **numbers_of(c),
            }
            for i, c in enumerate(s.clusters)
        ],
        "scores": scores,
    }


def table(segmentation: Segmentation, scores: dict[str, Any] | None) -> str:
    """Write the table as text: one row per material, then the scores.

    Parameters
    ----------
    segmentation : material maps
    scores : scores against the truth; None where there is none

    Returns
    -------
    text of several lines
    """
    clusters, options = segmentation.clusters, segmentation.options
    energies, agents = options.energies, tuple(segmentation.readouts.agents)
    virtual = bool(segmentation.readouts.mechanisms.edges)
    overlap = _dice_by_cluster(scores)
    wide = max(len("material"), *(len(c.name) for c in clusters)) + 2
    header = f"{'':>3} {'material':<{wide}}{'ml':>8}{'rho':>9}{'Z':>7}{'electrons':>11}"
    header += "".join(f"{f'{e:g} keV':>9}" for e in energies)
    header += f"{f'VNC {energies[0]:g}':>9}" if virtual and energies else ""
    header += "".join(f"{a:>8}" for a in agents) + (f"{'Dice':>8}" if overlap else "")
    units = ["ml", "1/mm", "-", "of water", *(["HU"] if energies else []), *(["mg/ml"] if agents else [])]
    lines = [f"{header}   [{', '.join(units)}]"]
    for i, c in enumerate(clusters):
        line = f"{i + 1:>3} {c.name:<{wide}}{c.volume_ml:8.2f}{c.features[0]:9.5f}"
        line += f"{_known(c.atomic_number, 2):>7}{_known(c.electron_density, 3):>11}"
        line += "".join(f"{v:9.0f}" for v in c.hounsfield)
        line += f"{c.without_contrast[0]:9.0f}" if virtual and energies else ""
        line += "".join(f"{c.concentrations[a]:8.2f}" for a in agents)
        line += f"{_known(overlap.get(c.name), 4):>8}" if overlap else ""
        lines.append(line)
    if len(clusters) == 1:
        lines.append("There is one material only; a smaller --bandwidth would split it.")
    return "\n".join([*lines, *_score_lines(scores)])


def _score_lines(scores: dict[str, Any] | None) -> list[str]:
    """Lines of the scores against the truth."""
    if scores is None:
        return []
    missed = [name for name, row in scores["materials"].items() if row["cluster"] is None and row["voxels"]]
    lines = ["", f"mean Dice of {len(scores['materials'])} materials {_known(scores['mean_dice'], 4)}"]
    if missed:
        lines.append(f"found no {', '.join(missed)}")
    for key, what in (("rgb_views", "views"), ("rgb_slices", "slices")):
        s = scores[key]
        parts = f"PSNR {_known(s['psnr'], 2)} dB, SSIM {_known(s['ssim'], 4)}, LPIPS {_known(s['lpips'], 3)}"
        lines.append(f"RGB {what:<7}{parts}")
    for element, fit in scores["concentration"].items():
        if fit["slope"] is not None:
            lines.append(
                f"{element:<3} slope {fit['slope']:.4f}, intercept {fit['intercept']:+.3f} mg/ml, "
                f"limit of detection {_known(fit['detection_limit'], 3)} mg/ml, cross-talk {fit['crosstalk']:.3f} mg/ml"
            )
    return lines


def _dice_by_cluster(scores: dict[str, Any] | None) -> dict[str, float]:
    """Dice coefficient of each cluster that was matched to a material."""
    if scores is None:
        return {}
    return {row["cluster"]: row["dice"] for row in scores["materials"].values() if row["cluster"] is not None}


def _known(value: float | None, digits: int) -> str:
    """Number as text, or a dash where it is not known."""
    return "-" if value is None or not np.isfinite(value) else f"{value:.{digits}f}"


def legend(clusters: tuple[Cluster, ...]) -> list[str]:
    """Create the text of each material in a legend: its name, and the concentration or density that distinguishes it.

    Parameters
    ----------
    clusters : materials

    Returns
    -------
    one text per material
    """
    texts = []
    for c in clusters:
        agent, amount = max(c.concentrations.items(), key=lambda item: item[1], default=("", 0.0))
        with_agent = c.name.startswith("K-edge") and amount > 0
        more = f"{amount:.3g} mg/ml {agent}" if with_agent else f"{1e3 * c.features[0]:.1f}"
        texts.append(f"{c.name}, {more}" if with_agent else f"{c.name}, $\\rho$ {more}")
    return texts
