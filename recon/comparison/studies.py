"""Studies of the paper: contenders of each, and its table with the numbers of the paper beside those measured."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from phantomgen.dataset.reader import open_dataset
from recon.comparison.contenders.contender import GAUSSIAN, PAPER, Contender, contender
from recon.comparison.tables.published_numbers import TABLE_1, TABLE_2, TABLE_3, TABLE_4A, TABLE_4B, TABLE_4C, Printed
from recon.comparison.tables.table import ABSENT, markdown_table, mean_psnr, mean_score, number
from spectra.basis.basis import pretty
from spectra.errors import InputError

Result = dict[str, Any]
Rows = list[list[str]]
_CHANNEL_WISE = {  # rows of Table 1 -> methods, channel by channel as in the paper
    "FDK": "fdk+image",
    "SART": "sart+image",
    "CGLS": "cgls+image",
    "PDHG-TV": "pdhg-tv+image",
    "IntraTomo": "neural+image",
    "SAX-NeRF": "sax-nerf+image",
    "X-Gaussian": "x-gaussian",
    "R2-Gaussian": "gaussian-mono+image",
    "X-Field": "ellipsoid+image",
}
_TWO_STEP, _ONE_STEP = ("fdk", "sart", "cgls", "pdhg-tv"), "one-step"


@dataclass(frozen=True)
class Scan:
    """Properties of a dataset that studies depend on.

    Parameters
    ----------
    channels : their names
    bases : number of basis functions
    views : number of training views
    """

    channels: tuple[str, ...]
    bases: int
    views: int


@dataclass(frozen=True)
class Study:
    """One of the paper's tables.

    Parameters
    ----------
    name : value of ``--study``
    title : of the table
    contenders : all that take part
    rows : function of results by contender and of the protocol, which gives header and lines of the table
    """

    name: str
    title: str
    contenders: tuple[Contender, ...]
    rows: Callable[[dict[str, Result], str], Rows]

    def page(self, results: Sequence[Result], protocol: str) -> str:
        """Write the table in Markdown, once per budget.

        Parameters
        ----------
        results : of `recon.comparison.campaign.Campaign.results`
        protocol : whose scores are shown

        Returns
        -------
        the page
        """
        parts = [
            f"# {self.title}",
            f"`{self.name}`, metric protocol `{protocol}`; the paper's numbers are of other scans.",
        ]
        for budget in sorted({result["budget"] for result in results if result["budget"] is not None}):
            own = {r["contender"]: r for r in results if r["budget"] == budget and "seconds" in r}
            header, *lines = self.rows(own, protocol)
            parts += [f"## {budget:g} s", markdown_table(header, lines)]
        return "\n\n".join(parts)


def study_named(name: str, dataset: Path) -> Study:
    """Prepare a study of a dataset.

    Parameters
    ----------
    name : one of `STUDIES`
    dataset : the file

    Returns
    -------
    the study

    Raises
    ------
    InputError
        When there is none of that name.
    """
    if name not in STUDIES:
        raise InputError(f"there is no study {name!r}: choose from {', '.join(STUDIES)}")
    with open_dataset(dataset) as opened:
        scan = Scan(opened.spectra.channels, len(opened.spectra.basis), len(opened.splits["train"]))
    return STUDIES[name](scan)


def views_and_volumes(scan: Scan) -> Study:
    """Prepare Table 1: scores of new views and of volumes of the channels.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study
    """
    words = _CHANNEL_WISE | _both(scan)

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        header = [
            "method",
            "as in the paper",
            *_pairs("views PSNR", "views SSIM", "views LPIPS", "volumes PSNR", "volumes SSIM"),
        ]
        lines = []
        for row, word in words.items():
            result, (views, volumes) = own.get(word, {}), TABLE_1.get(row, (None, None))
            line = [word, row]
            for key, layout in (("psnr", ".2f"), ("ssim", ".3f"), ("lpips", ".3f")):
                line += _beside(mean_score(result, "views", protocol, key), views, key, layout)
            for key, layout in (("psnr", ".2f"), ("ssim", ".3f")):
                line += _beside(mean_score(result, "energies", protocol, key), volumes, key, layout)
            lines.append(line)
        return [header, *lines]

    return _study("views-and-volumes", "Novel views and volumes of the channels, means over channels", words, rows)


def basis(scan: Scan) -> Study:
    """Prepare Table 2: scores of the basis volumes.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study
    """
    words = {row: _CHANNEL_WISE[row] for row in TABLE_2 if row in _CHANNEL_WISE} | _both(scan)
    words |= {f"{method}, ray by ray": method for method in _TWO_STEP} | {f"{_ONE_STEP}, from counts": _ONE_STEP}

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        names = next((list(r["basis"][protocol]) for r in own.values() if r["basis"].get(protocol)), [])
        header = ["method", "as in the paper", *_pairs(*(f"{pretty(n)} {k}" for n in names for k in ("PSNR", "SSIM")))]
        lines = []
        for row, word in words.items():
            scores, printed = own.get(word, {}).get("basis", {}).get(protocol, {}), TABLE_2.get(row, ())
            line = [word, row]
            for i, name in enumerate(names):
                beside = printed[i] if i < len(printed) else None
                for key, layout in (("psnr", ".2f"), ("ssim", ".3f")):
                    line += _beside(scores.get(name, {}).get(key), beside, key, layout)
            lines.append(line)
        return [header, *lines]

    return _study("basis", "Basis volumes", words, rows)


def material_maps(scan: Scan) -> Study:
    """Prepare Table 3: materials in colour, found by clustering.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study
    """
    counts = [m for m in (2, 3) if m <= scan.bases]
    words = {f"{method}+{m}": f"{method}+{m}" for method in (GAUSSIAN, PAPER) for m in counts} | {
        method: method for method in (*_TWO_STEP, _ONE_STEP)
    }

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        del protocol  # pictures have peak 1 in all of them
        header = [
            "method",
            "mean Dice",
            *_pairs("views PSNR", "views SSIM", "views LPIPS"),
            "slices PSNR",
            "slices SSIM",
        ]
        lines = []
        for word in words:
            maps = own.get(word, {}).get("maps") or {}
            views, slices = maps.get("rgb_views", {}), maps.get("rgb_slices", {})
            printed = TABLE_3.get(int(word[-1])) if word.startswith((GAUSSIAN, PAPER)) else None
            line = [word, number(maps.get("mean_dice"), ".3f")]
            for key, layout in (("psnr", ".2f"), ("ssim", ".3f"), ("lpips", ".3f")):
                line += _beside(views.get(key), printed, key, layout)
            lines.append([*line, number(slices.get("psnr"), ".2f"), number(slices.get("ssim"), ".3f")])
        return [header, *lines]

    return _study("material-maps", "Material maps beside the true materials, in colour", words, rows)


def held_out_channel(scan: Scan) -> Study:
    """Prepare Table 4a: prediction of a channel that is not fitted.

    The paper leaves out one of three channels. Its numbers are shown where the scan has three channels, too, as a
    prediction from two channels is not comparable with one from three.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study

    Raises
    ------
    InputError
        When there are no more channels than bases.
    """
    counts = [m for m in (2, 3) if m <= min(scan.bases, len(scan.channels) - 1)]
    if not counts:
        raise InputError(f"of {len(scan.channels)} channels none can be left out: {scan.bases} bases need as many")
    who = [f"{method}+{m}" for method in (GAUSSIAN, PAPER) for m in counts]
    words = {f"{w}, {c}": f"{w}+blind-{c}" for w in who for c in scan.channels} | {w: w for w in who}

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        header = ["method", "channel left out", "PSNR of it", "when fitted", "difference", "in the paper"]
        lines = []
        for w in who:
            printed = TABLE_4A[int(w[-1])]
            for i, channel in enumerate(scan.channels):
                blind, fitted = (_channel_psnr(own.get(k, {}), protocol, channel) for k in (f"{w}+blind-{channel}", w))
                place = 0 if i == 0 else 2 if i == len(scan.channels) - 1 else 1
                loss = None if blind is None or fitted is None else blind - fitted
                lost = printed[place][0] - printed[place][1] if len(scan.channels) == len(printed) else None
                numbers = (number(blind, ".2f"), number(fitted, ".2f"), number(loss, "+.2f"), number(lost, "+.2f"))
                lines.append([w, channel, *numbers])
        return [header, *lines]

    return _study("held-out-channel", "Prediction of a channel that was left out, test views", words, rows)


def few_views(scan: Scan) -> Study:
    """Prepare Table 4b: fits of 75, 50, 25 and 10 views, or of the same parts of fewer.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study
    """
    most = min(scan.views, max(TABLE_4B))
    counts = {max(round(most * n / max(TABLE_4B)), 1): n for n in TABLE_4B}
    who = (GAUSSIAN, PAPER, _ONE_STEP, "fdk")
    words = {f"{w}, {n}": f"{w}+views-{n}" for w in who for n in counts}

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        header = ["method", "views", "views PSNR", "basis PSNR", "views in the paper", "PSNR in the paper"]
        lines = []
        for w in who:
            for count, theirs in counts.items():
                result = own.get(f"{w}+views-{count}", {})
                scores = [number(mean_psnr(result, section, protocol), ".2f") for section in ("views", "basis")]
                beside = [str(theirs), f"{np.mean(TABLE_4B[theirs]):.2f}"] if w in (GAUSSIAN, PAPER) else [ABSENT] * 2
                lines.append([w, str(count), *scores, *beside])
        return [header, *lines]

    return _study("few-views", "Fewer training views, means over channels and bases", words, rows)


def ablation(scan: Scan) -> Study:
    """Prepare Table 4c: the paper's method without one of its components.

    Parameters
    ----------
    scan : properties of the dataset

    Returns
    -------
    the study
    """
    del scan
    words = {name: f"{PAPER}+without-{name}" if name else PAPER for name in TABLE_4C}

    def rows(own: dict[str, Result], protocol: str) -> Rows:
        header = ["without", *_pairs("views PSNR"), *_pairs("difference"), "basis PSNR"]
        whole, printed = mean_psnr(own.get(PAPER, {}), "views", protocol), float(np.mean(TABLE_4C[""]))
        lines = []
        for name, word in words.items():
            value, theirs = mean_psnr(own.get(word, {}), "views", protocol), float(np.mean(TABLE_4C[name]))
            change = None if value is None or whole is None else value - whole
            both = [number(value, ".2f"), f"{theirs:.2f}", number(change, "+.2f"), f"{theirs - printed:+.2f}"]
            lines.append([name or "nothing", *both, number(mean_psnr(own.get(word, {}), "basis", protocol), ".2f")])
        return [header, *lines]

    return _study("ablation", "Components of the paper's method left out, means over channels and bases", words, rows)


STUDIES: dict[str, Callable[[Scan], Study]] = {
    "views-and-volumes": views_and_volumes,
    "basis": basis,
    "material-maps": material_maps,
    "held-out-channel": held_out_channel,
    "few-views": few_views,
    "ablation": ablation,
}


def _study(name: str, title: str, words: dict[str, str], rows: Callable[[dict[str, Result], str], Rows]) -> Study:
    return Study(name, title, tuple(contender(word) for word in words.values()), rows)


def _both(scan: Scan) -> dict[str, str]:
    """The paper's method, and this project's fit, with as many bases as the scan has."""
    counts = [m for m in (2, 3) if m <= scan.bases]
    return {f"Ours ({m})": f"{PAPER}+{m}" for m in counts} | {f"recon fit ({m})": f"{GAUSSIAN}+{m}" for m in counts}


def _pairs(*names: str) -> list[str]:
    """Names of columns, each followed by that of the paper."""
    return [column for name in names for column in (name, f"{name} in the paper")]


def _beside(value: float | None, printed: Printed | None, key: str, layout: str) -> list[str]:
    """Measured value, and that of the paper."""
    return [number(value, layout), number(None if printed is None else getattr(printed, key), layout)]


def _channel_psnr(result: Result, protocol: str, channel: str) -> float | None:
    return result.get("views", {}).get(protocol, {}).get(channel, {}).get("psnr")
