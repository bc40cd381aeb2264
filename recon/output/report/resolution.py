"""Resolution and noise of a reconstruction: edge response, MTF, and noise power spectrum."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Integer, Real
from scipy import ndimage
from scipy.special import erfinv

from phantomgen.display.figures.style import PAGE_WIDTH, TRUTH, figure_file, write_csv
from phantomgen.display.html import Part, picture
from recon.evaluation.metrics import pure_voxels
from recon.evaluation.scoring import FULL_FRACTION
from recon.output.report.case import LINES, Case, LeftOut, Parts
from recon.quality.edge_response import edge_width, mtf
from recon.quality.noise_power import noise_power
from spectra.basis.basis import pretty

if TYPE_CHECKING:
    from matplotlib.figure import Figure

REACH = 3.0  # voxels; range of an edge response on both sides of the edge; our choice
STEP = 0.25  # voxels; width of a bin of an edge response; our choice
SMOOTHING = 1.0  # voxels; standard deviation of the smoothed fraction from which distances are computed; our choice
FLAT = 0.06  # part of the steepest slope; largest deviation of that field's slope from that of a plane; our choice
FEWEST = 8  # voxels; fewest in a bin of an edge response that is used; our choice
FILLED = 0.6  # part of the bins; fewest that must have so many voxels, while others are interpolated; our choice
SMALLEST = 8  # voxels; shortest side of a region whose noise is analysed; our choice


@dataclass(frozen=True, eq=False)
class Edge:
    """Voxels around the surface of one material, where it is next to one other material.

    Parameters
    ----------
    distance : distance of each of these voxels from the surface, positive outside [voxel]
    voxels : True for these voxels
    """

    distance: Float[np.ndarray, " voxel"]
    voxels: Bool[np.ndarray, "z y x"]

    def response(self, volume: Real[np.ndarray, "z y x"]) -> tuple[np.ndarray, np.ndarray]:
        """Compute the mean of a volume as a function of the distance from the surface.

        Parameters
        ----------
        volume : values of all voxels

        Returns
        -------
        distances [voxel] and means, interpolated between the mean distances of bins; empty arrays where there are too
        few voxels
        """
        edges = np.arange(-REACH, REACH + STEP / 2, STEP)
        number = np.histogram(self.distance, edges)[0]
        full = number >= FEWEST
        if not (full[0] and full[-1] and full.mean() >= FILLED):
            return np.empty(0), np.empty(0)
        weights = np.asarray(volume, dtype=np.float64)[self.voxels]
        sums = [np.histogram(self.distance, edges, weights=w)[0] for w in (self.distance, weights)]
        place, mean = (total[full] / number[full] for total in sums)
        middle = (edges[1:] + edges[:-1]) / 2
        return middle, np.interp(middle, place, mean)


def parts(case: Case) -> Parts:
    """Draw edge response and MTF per basis, and the spectrum of the noise in the largest uniform region.

    Parameters
    ----------
    case : runs of the report

    Returns
    -------
    parts of the page

    Raises
    ------
    LeftOut
        When there is no truth, or neither a surface that is large enough nor a uniform region.
    """
    truth = case.needs_truth()
    found: list[Part] = []
    path = case.path("edge_response")
    drawn = edge_figure(case, path)
    if drawn is not None:
        figure, text = drawn
        case.drawn(path, figure)
        caption = (
            "Edge response (left) and MTF, its transform (right), at the surface of the material with the largest "
            "coefficient in each basis; distances of voxels from the surface come from the true fractions. Truth is "
            f"the same for the true volume, the limit of voxels of this size. 10 to 90 % of the edge: {text}."
        )
        found.append(picture(path, caption))
    region = uniform_region(truth.fractions, truth.material_names)
    if region is not None:
        name, box = region
        side = box[1].stop - box[1].start
        path = case.path("noise_power")
        case.drawn(path, noise_figure(case, box, path))
        caption = (
            f"Noise power spectrum in axial slices of {name}: {box[0].stop - box[0].start} slices of {side} x {side} "
            "voxels, their mean planes subtracted. Its area is the variance; flat is white noise."
        )
        found.append(picture(path, caption))
    if not found:
        raise LeftOut("no surface between two materials is large enough, and no uniform region")
    return tuple(found)


def edge_figure(case: Case, path: Path | None = None) -> tuple["Figure", str] | None:
    """Draw a row per basis that has an edge, with a CSV.

    Parameters
    ----------
    case : runs of the report
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure, and the widths of the edges as text; None where no basis has an edge
    """
    truth, true = case.needs_truth(), case.true
    if true is None:
        return None
    found = []
    for i, name in enumerate(case.names):
        column = truth.coefficients[:, truth.basis_names.index(name)]
        edge = strongest_edge(truth.fractions, case.labels, column)
        if edge is not None and edge.response(true[i])[0].size:
            found.append((i, name, edge))
    if not found:
        return None
    voxel, table, words = min(case.grid.spacing), {}, []
    with figure_file(path, (PAGE_WIDTH, 1.45 * len(found) + 0.7)) as figure:
        axes = figure.subplots(len(found), 2, sharex="col", squeeze=False)
        for (i, name, edge), (left, right) in zip(found, axes, strict=True):
            curves = {"truth": true[i], **{case.label(run): run.volume(name, case.grid) for run in case.runs}}
            widths = []
            for (label, volume), (colour, dashes) in zip(curves.items(), ((TRUTH, "-"), *LINES), strict=False):
                distance, mean = edge.response(volume)
                response = (mean - mean[-4:].mean()) / ((mean[:4].mean() - mean[-4:].mean()) or 1.0)
                frequency, transfer = mtf(response, STEP)
                style = {"color": colour, "linestyle": dashes, "linewidth": 0.9 if label == "truth" else 1.4}
                left.plot(voxel * distance, response, label=label, **style)
                right.plot(frequency / voxel, transfer, **style)
                table |= {"distance_mm": voxel * distance, f"{name}_{label}_edge": response}
                widths.append(f"{label} {voxel * edge_width(distance, response):.2f} mm")
            words.append(f"{pretty(name)} {', '.join(widths)}")
            left.text(0.97, 0.92, pretty(name), transform=left.transAxes, ha="right", va="top", fontsize=8)
            left.set_ylabel("edge response")
            right.set(ylabel="MTF", ylim=(0, 1.15))
        axes[-1, 0].set_xlabel("distance from the surface [mm]")
        axes[-1, 1].set(xlabel="frequency [1/mm]", xlim=(0, 0.5 / voxel))
        figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper right", ncols=4)
    write_csv(path, table)
    return figure, "; ".join(words)


def strongest_edge(
    fractions: Integer[np.ndarray, "material z y x"],
    labels: Integer[np.ndarray, "z y x"],
    coefficients: Float[np.ndarray, " material"],
) -> Edge | None:
    """Find the surface of the material with the largest coefficient among those that fill at least 100 voxels.

    Parameters
    ----------
    fractions : material fractions, as integers
    labels : 0 for background, i + 1 for material i
    coefficients : coefficient of each material [1/mm]

    Returns
    -------
    surface; None where there is none
    """
    for material in np.argsort(-coefficients):
        if coefficients[material] > 0 and (labels == material + 1).sum() >= 100:
            return edge_of(fractions[material] / FULL_FRACTION, labels, int(material))
    return None


def edge_of(fraction: Float[np.ndarray, "z y x"], labels: Integer[np.ndarray, "z y x"], material: int) -> Edge:
    """Compute the distance of voxels from the surface of one material.

    Parameters
    ----------
    fraction : fraction of the material in each voxel, 0 to 1
    labels : 0 for background, i + 1 for material i
    material : index of the material

    Returns
    -------
    voxels near the surface, without those where the slope of the field is not that of a plane (corners, thin parts),
    and without those near third materials

    Notes
    -----
    A plane at distance d from a voxel, averaged over voxels and smoothed by a Gaussian of variance s^2, fills
    Phi(-d / s') of it with s'^2 = s^2 + 1/12, which is solved for d.
    """
    inside = labels == material + 1
    reach = int(REACH + 3 * SMOOTHING) + 1
    ends = [(np.flatnonzero(inside.any(axis=tuple({0, 1, 2} - {a})))[[0, -1]]) for a in range(3)]
    cut = tuple(slice(max(int(low) - reach, 0), high + reach + 1) for low, high in ends)
    field = ndimage.gaussian_filter(np.asarray(fraction[cut], dtype=np.float64), SMOOTHING, mode="nearest")
    width = np.sqrt(SMOOTHING**2 + 1 / 12)
    with np.errstate(divide="ignore"):
        distance = -width * np.sqrt(2) * erfinv(2 * field - 1)
    slope = np.sqrt(sum(np.square(part) for part in np.gradient(field)))
    plane = np.exp(-np.square(distance / width) / 2) / (np.sqrt(2 * np.pi) * width)
    near = np.abs(distance) < REACH
    flat = np.abs(slope - plane) < FLAT / (np.sqrt(2 * np.pi) * width)
    beside = labels[cut][(distance > 0) & (distance < 2) & ~inside[cut]]
    around = int(np.bincount(beside).argmax()) if beside.size else 0
    third = ~inside[cut] & (labels[cut] != around)
    clear = np.asarray(ndimage.distance_transform_edt(~third)) > REACH if third.any() else np.ones_like(near)
    used = near & flat & clear
    voxels = np.zeros(labels.shape, bool)
    voxels[cut] = used
    return Edge(distance[used], voxels)


def uniform_region(
    fractions: Integer[np.ndarray, "material z y x"], names: tuple[str, ...]
) -> tuple[str, tuple[slice, slice, slice]] | None:
    """Find the largest square that one material fills alone, in all slices where it does.

    Parameters
    ----------
    fractions : material fractions, as integers
    names : names of the materials

    Returns
    -------
    name of the material, and box (z, y, x) of voxels; None where no square of `SMALLEST` voxels is found
    """
    best: tuple[int, str, tuple[slice, slice, slice]] | None = None
    for name, fraction in zip(names, fractions, strict=True):
        pure = pure_voxels(fraction, FULL_FRACTION)
        deepest = pure.sum(axis=0) if pure.any() else np.zeros(pure.shape[1:])
        common = deepest >= 0.8 * deepest.max() if deepest.max() > 0 else np.zeros(pure.shape[1:], bool)
        half = np.asarray(ndimage.distance_transform_cdt(common, "chessboard"))
        y, x = np.unravel_index(int(half.argmax()), half.shape)
        reach = int(half[y, x]) - 1
        if 2 * reach + 1 < SMALLEST:
            continue
        square = (slice(y - reach, y + reach + 1), slice(x - reach, x + reach + 1))
        whole = np.flatnonzero(pure[:, square[0], square[1]].all(axis=(1, 2)))
        if len(whole) and whole[-1] - whole[0] + 1 == len(whole) and (best is None or reach > best[0]):
            best = reach, name, (slice(int(whole[0]), int(whole[-1]) + 1), *square)
    return None if best is None else best[1:]


def noise_figure(case: Case, box: tuple[slice, slice, slice], path: Path | None = None) -> "Figure":
    """Draw the noise power spectra of all runs, in a panel per basis, with a CSV.

    Parameters
    ----------
    case : runs of the report
    box : region (z, y, x) of voxels
    path : figure to write, with its CSV where it has one; None for no file

    Returns
    -------
    the figure
    """
    table = {}
    with figure_file(path, (PAGE_WIDTH, 1.35 * len(case.names) + 0.6)) as figure:
        axes = figure.subplots(len(case.names), 1, sharex=True, squeeze=False)[:, 0]
        for ax, name in zip(axes, case.names, strict=True):
            for run, (colour, dashes) in zip(case.runs, LINES, strict=False):
                frequency, power = noise_power(run.volume(name, case.grid), case.grid, box)
                positive = np.where(power > 0, power, np.nan)
                ax.plot(frequency, positive, color=colour, linestyle=dashes, label=case.label(run))
                table |= {"frequency_per_mm": frequency, f"{name}_{case.label(run)}": power}
            ax.text(0.98, 0.9, pretty(name), transform=ax.transAxes, ha="right", va="top", fontsize=8)
            if any(np.any(line.get_ydata() > 0) for line in ax.get_lines()):
                ax.set_yscale("log")
            ax.set_ylabel("NPS [no unit]")
        axes[-1].set_xlabel("frequency [1/mm]")
        if len(case.runs) > 1:
            figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper right", ncols=3)
        figure.align_ylabels()
    write_csv(path, table)
    return figure
