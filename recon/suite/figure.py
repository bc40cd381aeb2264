"""Figure of results on a suite: a line per case, a mark per method."""

from pathlib import Path

from phantomgen.display.figures.style import GRID, WIDTH, figure_file
from recon.comparison.tables.figure import COLOURS, MARKERS
from recon.suite.results import Results
from recon.suite.table import case_names, mean_levels


def cases_and_methods(results: Results, path: Path) -> Path | None:
    """Draw the mean PSNR of the basis volumes: a line per case, a mark per method.

    Parameters
    ----------
    results : of one submission or of several
    path : picture to write

    Returns
    -------
    the picture; None where there is no such number
    """
    cases, levels = case_names(results), mean_levels(results)
    if not any(value is not None for own in levels.values() for value in own.values()):
        return None
    high = 1.1 + 0.32 * len(cases) + 0.17 * ((len(levels) - 1) // 4)
    with figure_file(path, (WIDTH, high)) as figure:
        ax = figure.subplots()
        for place in range(len(cases)):
            ax.axhline(place, color=GRID, linewidth=0.8, zorder=0)
        for i, (name, own) in enumerate(levels.items()):
            points = [(value, cases.index(case)) for case, value in own.items() if value is not None]
            x, y = zip(*points, strict=True) if points else ((), ())
            mark, colour = MARKERS[i % len(MARKERS)], COLOURS[i % len(COLOURS)]
            inside = colour if i < len(COLOURS) else "none"  # a second round of colours is not filled
            ax.plot(x, y, mark, color=colour, markerfacecolor=inside, markersize=6, label=name)
        ax.set_yticks(range(len(cases)), cases)
        ax.set_ylim(len(cases) - 0.5, -0.5)
        ax.set_xlabel("mean PSNR of the basis volumes [dB]")
        figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return path
