"""Figure of error against time: one line per contender, one panel per basis."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.display.figures.style import GRAY, WIDTH, figure_file, write_csv
from spectra.basis.basis import pretty

Result = dict[str, Any]
COLOURS = ("#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2", "#CC79A7", "#8C6D31")  # Okabe and Ito
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*")
_ACROSS = 4  # panels in a row
_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)))


def error_against_time(results: Sequence[Result], path: Path, clock: str) -> Path | None:
    """Draw PSNR of each basis volume against time; finished volumes, whose time is not known, are dashed levels.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    path : PNG to write; a CSV with the numbers is written beside it
    clock : ``wall`` or ``cpu``

    Returns
    -------
    the picture; None where there is no truth
    """
    lines, ends = _lines(results), _ends(results)
    points_of_all = [point for points in lines.values() for point in points]
    levels = [r["level"] for r in results if r.get("level")]
    names = list(dict.fromkeys(key for point in (*points_of_all, *levels) for key in point if _is_psnr(key)))
    if not names:
        return None
    budgets = sorted({result["budget"] for result in results if result["budget"] is not None})
    finished = {r["contender"]: r["level"] for r in results if r["budget"] is None and r.get("level")}
    across = min(len(names), _ACROSS)
    down = -(-len(names) // across)
    high = 3.1 + 2.4 * (down - 1) + 0.16 * ((len(lines) + len(finished) - 1) // 4)
    with figure_file(path, (WIDTH, high)) as figure:
        axes = figure.subplots(down, across, sharex=True, squeeze=False).ravel()
        for ax in axes[len(names) :]:
            ax.set_axis_off()
        axes = axes[: len(names)]
        for ax, name in zip(axes, names, strict=True):
            for budget in budgets:
                ax.axvline(budget, color=GRAY, linewidth=0.8, linestyle=(0, (1, 2)), zorder=0)
            for i, (who, points) in enumerate(lines.items()):
                _draw(ax, i, who, _pairs(points, name), _pairs(ends[who], name))
            for i, (who, level) in enumerate(finished.items(), len(lines)):
                options = {"color": COLOURS[i % len(COLOURS)], "linestyle": (0, (6, 2)), "linewidth": 1.2}
                if name in level:
                    ax.axhline(level[name], **options)
                ax.plot([], [], label=who, **options)
            ax.set_xscale("log")
            ax.xaxis.set_major_formatter("{x:g}")
            ax.set_title(pretty(name.removeprefix("psnr_")))
            ax.tick_params(labelbottom=True)
            ax.set_xlabel("processor time [s]" if clock == "cpu" else "time [s]")
            ax.set_ylim(*_limits(lines, name, [level[name] for level in finished.values() if name in level]))
        for ax in axes[::across]:
            ax.set_ylabel("PSNR of the volume [dB]")
        if not points_of_all:
            axes[0].set_xlim(0.1, 10 * max(budgets, default=1.0))
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4)
    _write_numbers(path, lines | {who: [{"seconds": np.nan} | level] for who, level in finished.items()}, names)
    return path


def _lines(results: Sequence[Result]) -> dict[str, list[dict[str, float]]]:
    """Points of each contender in order of time, those of its longest run."""
    found: dict[str, list[dict[str, float]]] = {}
    for who, own in _by_contender(results).items():
        longest = max(own, key=lambda r: r["budget"])
        found[who] = [p for p in longest["curve"] if p["seconds"] <= longest["seconds"]]
    return found


def _ends(results: Sequence[Result]) -> dict[str, list[dict[str, float]]]:
    """Collect the results of each contender at each budget; shorter schedules end beside the line of the longest."""
    return {
        who: [next(p for p in reversed(r["curve"]) if p["seconds"] <= r["seconds"]) for r in own]
        for who, own in _by_contender(results).items()
    }


def _by_contender(results: Sequence[Result]) -> dict[str, list[Result]]:
    found: dict[str, list[Result]] = {}
    for result in results:
        if result.get("curve"):
            found.setdefault(result["contender"], []).append(result)
    return found


def _draw(ax: Any, i: int, who: str, points: np.ndarray, ends: np.ndarray) -> None:
    """A line through points, and a marker at each end; (point, 2) seconds and PSNR."""
    colour, dash = COLOURS[i % len(COLOURS)], _DASHES[i // len(COLOURS) % len(_DASHES)]
    ax.plot(*points.T, color=colour, linestyle=dash, linewidth=2.0 if who == "gaussian" else 1.2, zorder=2)
    ax.plot(*ends.T, color=colour, marker=MARKERS[i % len(MARKERS)], linestyle="none", markersize=5, zorder=3)
    ax.plot([], [], color=colour, marker=MARKERS[i % len(MARKERS)], linestyle=dash, markersize=5, label=who)


def _pairs(points: list[dict[str, float]], name: str) -> np.ndarray:
    return np.array([(p["seconds"], p[name]) for p in points if name in p]).reshape(-1, 2)


def _limits(lines: dict[str, list[dict[str, float]]], name: str, levels: list[float]) -> tuple[float, float]:
    """From a little below the worst end, or the tenth part of all points, to a little above the best."""
    ends = [points[-1][name] for points in lines.values() if name in points[-1]] + levels
    values = [p[name] for points in lines.values() for p in points if name in p] + levels
    low = min([*ends, float(np.quantile(values, 0.1))])
    return low - 1.0, max(values) + 1.0


def _is_psnr(key: str) -> bool:
    return key.startswith("psnr_")


def _write_numbers(path: Path, lines: dict[str, list[dict[str, float]]], names: list[str]) -> None:
    """All points; contenders by their number, in the order of the legend."""
    rows = [
        (i, p["seconds"], *(p.get(n, np.nan) for n in names)) for i, points in enumerate(lines.values()) for p in points
    ]
    columns = np.array(rows).T
    write_csv(path, dict(zip(["line", "seconds", *names], columns, strict=True)))
