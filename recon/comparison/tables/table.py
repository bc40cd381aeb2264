"""Tables of results in Markdown and CSV."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.comparison.contenders.contender import GAUSSIAN
from spectra.basis.basis import pretty

Result = dict[str, Any]
ABSENT = "-"
EARLY = 0.95  # part of a budget; the table marks runs that finished before as stopped by themselves


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table in Markdown with aligned columns.

    Parameters
    ----------
    header : names of the columns
    rows : cells; the first column is text, the others are numbers

    Returns
    -------
    the table
    """
    lines = [list(map(str, header)), *(list(map(str, row)) for row in rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(header))]
    rule = ["-" * widths[0], *("-" * (w - 1) + ":" for w in widths[1:])]
    lines.insert(1, rule)
    aligned = [[line[0].ljust(widths[0]), *map(str.rjust, line[1:], widths[1:])] for line in lines]
    return "\n".join(f"| {' | '.join(line)} |" for line in aligned)


def number(value: float | None, layout: str) -> str:
    """Format a number.

    Parameters
    ----------
    value : number; None for none
    layout : format of Python

    Returns
    -------
    the number, or a dash
    """
    return ABSENT if value is None else format(value, layout)


def name_of(result: Result) -> str:
    """Format contender and budget of a result.

    Parameters
    ----------
    result : a result

    Returns
    -------
    first cell of its row
    """
    return result["contender"] if result["budget"] is None else f"{result['contender']}, {result['budget']:g} s"


def report(results: Sequence[Result], protocol: str, title: str) -> str:
    """Write a page with all tables of a comparison.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    protocol : whose scores are shown
    title : of the page

    Returns
    -------
    the page in Markdown
    """
    good = [result for result in results if "seconds" in result]
    parts = [
        f"# {title}",
        f"Metric protocol: `{protocol}`. PSNR in dB, over the peak that the protocol says; scoring does not count.",
        _section("Runs", run_table(results)),
        _section("Basis volumes", basis_table(good, protocol)),
        _section("Volumes at the mean energy of each channel", channel_table(good, "energies", protocol)),
        _section("Attenuation at other energies, and densities", channel_table(good, "stated", protocol)),
        _section("Views that no method has seen", channel_table(good, "views", protocol)),
        _section("Chi-square of the counts of those views", chi_square_table(good)),
        _section("Bias and noise inside materials [1e-3/mm]", material_table(good)),
        _section("Material maps: Dice, and colours beside the true ones", map_table(good)),
        _section("Remarks on volumes of other programs", "\n".join(remarks(good))),
        "\n".join(["## Gaussians beside the others", "", *methods_ahead(good, protocol)])
        if methods_ahead(good, protocol)
        else "",
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def remarks(results: Sequence[Result]) -> list[str]:
    """List what looks wrong about volumes of other programs.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    a line per remark, each once
    """
    return list(dict.fromkeys(f"- {r['contender']}: {text}." for r in results for text in r.get("remarks", ())))


def _section(title: str, table: str) -> str:
    return f"## {title}\n\n{table}" if table else ""


def run_table(results: Sequence[Result]) -> str:
    """Write the table of time, memory and size of every run, with the reason of failures.

    It names runs that stopped by themselves long before the end of their budget.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    the table
    """
    header = ("method, budget", "seconds", "iterations", "peak memory [MiB]", "size")
    rows = []
    for r in results:
        if "error" in r:
            rows.append((name_of(r), ABSENT, ABSENT, ABSENT, r["error"]))
            continue
        size = f"{r['primitives']} {r['kind']}"
        steps = f"{r['done']} of {r['total']}{ending(r)}" if "level" not in r else ABSENT
        rows.append((name_of(r), number(r["seconds"], ".1f"), steps, number(r["peak_memory_mib"], ".0f"), size))
    return markdown_table(header, rows)


def ending(result: Result) -> str:
    """Format how a run ended.

    Parameters
    ----------
    result : a result

    Returns
    -------
    whether the budget stopped it, or it stopped by itself well before; else empty
    """
    if not result["finished"]:
        return " (stopped by the budget)"
    if result["budget"] is not None and result["seconds"] < EARLY * result["budget"]:
        return f" (stopped by itself after {result['seconds']:.0f} of {result['budget']:g} s)"
    return ""


def basis_table(results: Sequence[Result], protocol: str) -> str:
    """Write the table of PSNR, PSNR after the best scalar, and SSIM of each basis, and of volumes of zeros.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    protocol : whose scores are shown

    Returns
    -------
    the table; empty where no result has such scores
    """
    names = _items(results, "basis", protocol)
    if not names:
        return ""
    header = ["method, budget", "mean PSNR"]
    header += [f"{pretty(n)} {what}" for n in names for what in ("PSNR", "scaled", "SSIM")]
    zero = _first(results, "basis", protocol)
    rows = [["zeros", ABSENT, *(c for n in names for c in (number(zero[n].get("psnr_zero"), ".1f"), ABSENT, ABSENT))]]
    for r in results:
        scores = r["basis"].get(protocol, {})
        cells = [
            number(scores.get(n, {}).get(key), layout)
            for n in names
            for key, layout in (("psnr", ".2f"), ("psnr_scaled", ".2f"), ("ssim", ".3f"))
        ]
        rows.append([name_of(r), number(mean_psnr(r, "basis", protocol), ".2f"), *cells])
    return markdown_table(header, rows)


def channel_table(results: Sequence[Result], section: str, protocol: str) -> str:
    """Write the table of PSNR, SSIM and, for views, LPIPS of each channel and their mean.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    section : ``views``, ``energies`` or ``stated``
    protocol : whose scores are shown

    Returns
    -------
    the table; empty where no result has such scores
    """
    names = list(dict.fromkeys(name for r in results for name in r.get(section, {}).get(protocol, {})))
    if not names:
        return ""
    keys = [("psnr", "PSNR", ".2f"), ("ssim", "SSIM", ".3f")]
    if section == "views":
        keys.append(("lpips", "LPIPS", ".3f"))
    header = ["method, budget", *(f"{n} {label}" for n in [*names, "mean"] for _, label, _ in keys)]
    rows = []
    for r in results:
        scores = r.get(section, {}).get(protocol, {})
        cells = [number(scores.get(n, {}).get(key), layout) for n in names for key, _, layout in keys]
        means = [number(_mean([scores.get(n, {}).get(key) for n in names]), layout) for key, _, layout in keys]
        rows.append([name_of(r), *cells, *means])
    return markdown_table(header, rows)


def chi_square_table(results: Sequence[Result]) -> str:
    """Write the table of chi-square per channel, of rays away from edges and of all rays.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    the table; empty where no result has such scores
    """
    names = list(next((r["chi_square"] for r in results if r["chi_square"]), {}))
    if not names:
        return ""
    header = ["method, budget", *(f"{n} {what}" for n in names for what in ("off edges", "all"))]
    rows = [
        [name_of(r), *(number(r["chi_square"].get(n, {}).get(k), ".4g") for n in names for k in ("away", "all"))]
        for r in results
    ]
    return markdown_table(header, rows)


def material_table(results: Sequence[Result]) -> str:
    """Write the table of mean error and standard deviation of each basis in each material [1e-3/mm].

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    the table; empty where no result has such scores
    """
    some = next((r["materials"] for r in results if r.get("materials")), {})
    pairs = [(m, b) for m, scores in some.items() if scores["voxels"] for b in scores if b != "voxels"]
    if not pairs:
        return ""
    header = ["method, budget", *(f"{m} {pretty(b)}" for m, b in pairs)]
    rows = []
    for r in results:
        cells = [r.get("materials", {}).get(m, {}).get(b, {}) for m, b in pairs]
        rows.append([name_of(r), *(_spread(cell) for cell in cells)])
    return markdown_table(header, rows)


def map_table(results: Sequence[Result]) -> str:
    """Write the table of Dice per material, and of the similarity of views and slices in colour.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`

    Returns
    -------
    the table; empty where no result has such scores
    """
    names = list(next((r["maps"]["dice"] for r in results if r.get("maps")), {}))
    if not names:
        return ""
    header = ["method, budget", "mean Dice", *names, "views PSNR", "views SSIM", "slices PSNR", "slices SSIM"]
    rows = []
    for r in results:
        maps = r.get("maps") or {}
        dice = [number(maps.get("dice", {}).get(name), ".3f") for name in names]
        pictures = [
            number(maps.get(f"rgb_{what}", {}).get(key), layout)
            for what in ("views", "slices")
            for key, layout in (("psnr", ".2f"), ("ssim", ".3f"))
        ]
        rows.append([name_of(r), number(maps.get("mean_dice"), ".3f"), *dice, *pictures])
    return markdown_table(header, rows)


def methods_ahead(results: Sequence[Result], protocol: str) -> list[str]:
    """Compare the fit of Gaussians with the other methods by PSNR of each basis.

    Parameters
    ----------
    results : of `recon.comparison.campaign.Campaign.results`
    protocol : whose scores are shown

    Returns
    -------
    a sentence per budget and basis, which names the methods that are better
    """
    lines = []
    for ours in (r for r in results if r["contender"] == GAUSSIAN and r.get("basis", {}).get(protocol)):
        others = [r for r in results if r["budget"] in (ours["budget"], None) and r is not ours]
        for name, scores in ours["basis"][protocol].items():
            ahead = [
                f"{r['contender']} by {gain:.2f} dB"
                for r in others
                if (gain := _gain(r.get("basis", {}).get(protocol, {}).get(name, {}), scores)) > 0
            ]
            said = "ahead are " + ", ".join(ahead) if ahead else "no method is ahead"
            lines.append(f"- {ours['budget']:g} s, {pretty(name)}: {said}.")
    return lines


def mean_score(result: Result, section: str, protocol: str, key: str) -> float | None:
    """Average a score over bases or channels.

    Parameters
    ----------
    result : a result
    section : ``basis``, ``views`` or ``energies``
    protocol : of the scores
    key : of the score, such as ``ssim``

    Returns
    -------
    mean; None where a value is missing
    """
    values = [scores.get(key) for scores in result.get(section, {}).get(protocol, {}).values()]
    return None if None in values else _mean(values)


def mean_psnr(result: Result, section: str, protocol: str) -> float | None:
    """Average PSNR over bases or channels.

    Parameters
    ----------
    result : a result
    section : ``basis``, ``views`` or ``energies``
    protocol : of the scores

    Returns
    -------
    mean [dB]; None where a value is missing
    """
    return mean_score(result, section, protocol, "psnr")


def write_csv(path: Path, results: Sequence[Result]) -> None:
    """Write one line per number: contender, budget, seconds, section, protocol, item, metric, value.

    Parameters
    ----------
    path : CSV file
    results : of `recon.comparison.campaign.Campaign.results`
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("contender", "budget", "seconds", "section", "protocol", "item", "metric", "value"))
        for result in results:
            head = (result["contender"], result["budget"], result.get("seconds", ""))
            writer.writerows((*head, *line) for line in _lines(result))


def _lines(result: Result) -> Iterator[tuple[str, str, str, str, float | str]]:
    """Every number of a result."""
    for section in ("views", "energies", "stated", "basis"):
        for protocol, items in result.get(section, {}).items():
            for item, scores in items.items():
                yield from ((section, protocol, item, metric, _plain(v)) for metric, v in scores.items())
    for item, scores in result.get("chi_square", {}).items():
        yield from (("chi_square", "", item, metric, _plain(v)) for metric, v in scores.items())
    for material, bases in result.get("materials", {}).items():
        for basis, scores in bases.items():
            if isinstance(scores, dict):
                yield from (("materials", "", f"{material}/{basis}", metric, _plain(v)) for metric, v in scores.items())
    maps = result.get("maps") or {}
    yield from (("maps", "", material, "dice", _plain(v)) for material, v in maps.get("dice", {}).items())
    for what in ("rgb_views", "rgb_slices"):
        yield from (("maps", "", what, metric, _plain(v)) for metric, v in maps.get(what, {}).items())
    for metric in ("peak_memory_mib", "primitives", "done", "total"):
        if metric in result:
            yield "run", "", "", metric, _plain(result[metric])


def _plain(value: float | None) -> float | str:
    return "" if value is None else value


def _items(results: Sequence[Result], section: str, protocol: str) -> list[str]:
    return list(_first(results, section, protocol))


def _first(results: Sequence[Result], section: str, protocol: str) -> dict[str, Any]:
    """Scores of the first result that has them."""
    return next((r[section][protocol] for r in results if r.get(section, {}).get(protocol)), {})


def _mean(values: Sequence[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _spread(scores: dict[str, float | None]) -> str:
    bias, sd = scores.get("bias"), scores.get("sd")
    return ABSENT if bias is None or sd is None else f"{1e3 * bias:+.3f} ± {1e3 * sd:.3f}"


def _gain(theirs: dict[str, Any], ours: dict[str, Any]) -> float:
    """PSNR of theirs over ours [dB]; not positive where either has none."""
    values = theirs.get("psnr"), ours.get("psnr")
    return -np.inf if None in values else float(values[0] - values[1])  # type: ignore[operator]
