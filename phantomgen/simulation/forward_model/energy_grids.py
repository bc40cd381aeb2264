"""The two energy grids of a scan: a fine one to simulate with, a coarse one to tell the reconstructor.

The simulator works on attenuation curves of materials, exact ones where a composition is given; the reconstructor
only gets bins and basis functions. Where all materials are explicit coefficients, nodes are sought in the space of
basis functions, which has fewer dimensions, and then translated.
"""

from dataclasses import replace
from itertools import pairwise
from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int64
from scipy.linalg import block_diag
from scipy.optimize import lsq_linear

from phantomgen.dataset.beam_profile import StoredProfile
from phantomgen.dataset.spectral_model import Spectra
from phantomgen.dataset.truth import CoefficientFit
from phantomgen.scene.scan import Scan
from spectra.detector.detector import AnyDetector
from spectra.detector.pile_up import PulseResponse
from spectra.energy.grid import Energies
from spectra.energy.interpolative_decomposition import interpolative_decomposition
from spectra.transmission import Transmission

# Widest bins of the simulator before nodes are sought [keV], and the most parts that one is cut into.
STEP = 0.125
_MOST_PARTS = 64
# Bins are compared with so many times finer ones, on so many rays.
_FINER, _BIN_RAYS = 2, 300
NO_CUTS = np.empty(0)
# Energy bins of the spectra in a dataset; edges and thresholds add some.
RECONSTRUCTOR_BINS = 128
FIT_WEIGHTS = "open-beam counts of all channels together, in bins of at most 1 keV"
# Worse fits [relative rms] are said aloud; those of tissues, plastics and metals up to iron stay below 2 %.
_POOR_FIT = 0.05
# Above so many columns the search for nodes samples its box too thinly: then it goes by way of fewer columns, as most
# materials are combinations of a few; where even these are too many, bins are chosen along the rays of the scan.
_MOST_COLUMNS = 6
# Most columns that others are combinations of, and rays that these are sought on.
_MOST_SPANNING = 10
_SPANNING_RAYS = 2000
# Rays along which spectra are computed, at most twice as many.
_SPECTRUM_RAYS = 300
# Sampled rays may miss the longest path of all.
_MARGIN = 1.1
# Signals of energies are drawn from Poisson counts in at most so many groups of photons, by equal steps of energy.
_PHOTON_GROUPS = 12
# Rays that the signals of photons are found on.
_GROUP_RAYS = 400
# Keeps quotients finite [1/mm].
_TINY = 1e-300
# Signals of photons are drawn to the energies of their nodes by this part of the squared relative error of variances.
_TO_NODES = 1e-4
# Rays that less than this part of the signal passes have no noise to speak of; room around limits. No unit.
_DARK, _ROUNDING = 1e-12, 1e-9


class PhotonGroups(NamedTuple):
    """Groups of photons whose numbers are drawn to make the noise of a summed signal.

    Parameters
    ----------
    signals : path lengths to the expected signal of each group
    channels : channel of each group, ascending
    quanta : signal of one photon of each group [keV]
    """

    signals: Transmission
    channels: Int64[np.ndarray, " group"]
    quanta: Float[np.ndarray, " group"]


def fine_transmission(
    scan: Scan, cuts: Float[np.ndarray, " cut"] = NO_CUTS, grouped: bool = False, step: float = STEP
) -> Transmission:
    """Create the transmission from path lengths per material, and those of the beam's profile, to expected counts.

    See `compressed_transmission`.

    Parameters
    ----------
    scan : what is simulated
    cuts : where bins end besides [keV], see `fine_cuts`
    grouped : whether counters where pulses pile up are split into groups of heights, one channel each
    step : bin width [keV]

    Returns
    -------
    transmission on bins of `step` keV; see `compressed_transmission` for few nodes
    """
    energies, weights, names = _rows(scan, step, cuts, grouped)
    return Transmission.from_spectrum(weights, _curves(scan, energies.nodes), names)


def fine_cuts(
    scan: Scan, lengths: Float[np.ndarray, "ray material"], tolerance: float
) -> tuple[Float[np.ndarray, " cut"], float]:
    """Find the energies at which bins of `STEP` keV are cut into finer ones, and the worst error of log counts left.

    A bin across which the exponent of a ray changes by s makes an error of s^2 / 24 of its photons; n parts make
    1 / n^2 of that. Parts are shared out so that the sum over bins meets the tolerance with the fewest of them.

    Parameters
    ----------
    scan : what is simulated
    lengths : path lengths of rays that meet every object [mm]
    tolerance : worst error of log counts that is wanted

    Returns
    -------
    cuts [keV], and the error on the given rays
    """
    rng, longest = np.random.default_rng(0), np.argsort(lengths.sum(axis=1), kind="stable")[-_BIN_RAYS // 4 :]
    some = rng.integers(len(lengths), size=_BIN_RAYS if len(lengths) else 0)
    rays = _with_profile_lengths(scan, lengths[np.append(some, longest)])
    energies, weights = _weights(scan, STEP)
    wide = energies.widths > STEP / 4  # the narrow bins of lines stay whole
    shares = np.where(wide, _shares(scan, energies, weights, rays), 0.0)
    best = NO_CUTS, np.inf
    for aim in (np.inf, tolerance, tolerance / 4, tolerance / 16):
        parts, more = 1.0, np.ones(len(energies))
        while (shares / (24 * more**2)).sum() > aim and parts < _MOST_PARTS**3 / shares.max(initial=0.0):
            parts *= 2
            more = np.clip(np.ceil(np.cbrt(parts * shares)), 1, _MOST_PARTS)
        cuts, finer = (_cut(energies.edges, np.where(wide, factor * more, 1)) for factor in (1, _FINER))
        logs, exact = (fine_transmission(scan, c).log_projection(rays) for c in (cuts, finer))
        # Midpoints err by the square of the width, so those of finer bins by a part of the same error.
        error = float(np.abs(logs - exact).max(initial=0.0) / (1 - _FINER**-2))
        best = min(best, (cuts, error), key=lambda found: found[1])
        if error <= tolerance:
            break
    return best


def _shares(
    scan: Scan, energies: Energies, weights: Float[np.ndarray, "channel energy"], rays: Float[np.ndarray, "ray column"]
) -> Float[np.ndarray, " energy"]:
    """Square of each bin's change of the exponent, times its part of a channel's counts, for the worst ray."""
    near = 1e-6 * energies.widths
    low, high = (_curves(scan, nodes) for nodes in (energies.edges[:-1] + near, energies.edges[1:] - near))
    change = (rays @ (high - low)) ** 2
    left = np.exp(-rays @ _curves(scan, energies.nodes))
    worst = np.zeros(len(energies))
    for row in weights:
        counts = left * row
        total = np.maximum(counts.sum(axis=1, keepdims=True), np.finfo(float).tiny)
        worst = np.maximum(worst, (counts / total * change).max(axis=0, initial=0.0))
    return worst


def _cut(edges: Float[np.ndarray, " edge"], parts: Float[np.ndarray, " energy"]) -> Float[np.ndarray, " cut"]:
    """Return the ends of bins that are cut into equal parts, and the cuts; between cuts, grids are laid out anew."""
    cuts = [np.linspace(a, b, int(n) + 1) for (a, b), n in zip(pairwise(edges), parts, strict=True) if n > 1]
    return np.unique(np.concatenate([np.empty(0), *cuts]))


def compressed_transmission(
    scan: Scan,
    lengths: Float[np.ndarray, "ray material"],
    tolerance: float,
    cuts: Float[np.ndarray, " cut"] = NO_CUTS,
    refine: bool = True,
    grouped: bool = False,
    step: float = STEP,
) -> tuple[Transmission, float]:
    """Create a transmission as `fine_transmission`, with few nodes.

    Parameters
    ----------
    scan : what is simulated
    lengths : path lengths of rays that meet every object [mm]; they span the box of what can be reached; those of the
        beam's profile are added
    tolerance : worst error of log counts that is wanted
    cuts : where bins end besides [keV], see `fine_cuts`
    refine : whether nodes are merged and moved, for the fewest of them, or chosen only
    grouped : as for `fine_transmission`
    step : bin width before nodes are sought [keV]

    Returns
    -------
    the transmission, and the worst error of log counts that was found on fresh rays of the box
    """
    materials, lengths = scan.scene.materials, _with_profile_lengths(scan, lengths)
    if any(m.composition is not None for m in materials) or len(materials) <= len(scan.basis):
        return _compress(fine_transmission(scan, cuts, grouped, step), lengths, tolerance, refine)
    energies, weights, names = _rows(scan, step, cuts, grouped)
    columns = _with_profile(scan, scan.basis.evaluate(energies.nodes), energies.nodes)
    fine = Transmission.from_spectrum(weights, columns, names)
    coefficients = material_coefficients(scan)
    if scan.profile is not None:
        coefficients = block_diag(coefficients, np.eye(len(scan.profile.names)))
    small, error = _compress(fine, lengths @ coefficients, tolerance, refine)
    return Transmission(coefficients @ small.columns, small.weights, small.starts, small.channel_names), error


def photon_groups(
    scan: Scan,
    transmission: Transmission,
    lengths: Float[np.ndarray, "ray material"],
    cuts: Float[np.ndarray, " cut"] = NO_CUTS,
) -> PhotonGroups | None:
    """Divide the energy nodes of summed signals into groups of photons.

    The number of photons of a group is Poisson, and each adds the same signal. These signals are near the energies of
    the nodes, and such that variances are those of all energies, within 0.2 %; third cumulants err by up to 2 %. Both
    depend on the longest lengths only, as nodes do: more views of a scan do not change the noise of the others.

    Parameters
    ----------
    scan : what is simulated
    transmission : path lengths to signals of channels, with few nodes
    lengths : path lengths of rays that meet every object [mm]
    cuts : of the bins that the nodes replace [keV]

    Returns
    -------
    the groups; None where photons are counted
    """
    energies, weights = _weights(scan, STEP, cuts)
    if scan.detector.variance(energies) is None:
        return None
    rays = _rays_of_box(_with_profile_lengths(scan, lengths))
    curves = _curves(scan, energies.nodes)
    left, node_energy = np.exp(-rays @ curves), node_energies(scan, transmission, np.arange(len(weights)), cuts)
    order, starts, channels, quanta = [], [0], [], []
    for c, (first, last) in enumerate(pairwise(transmission.starts)):
        own, seen = node_energy[first:last], energies.nodes[weights[c] > 0]
        steps = np.linspace(seen[0], seen[-1], _PHOTON_GROUPS + 1)[1:-1]
        group = np.searchsorted(steps, own, side="right")
        signals = transmission.weights[first:last] * np.exp(-rays @ transmission.columns[:, first:last])
        members = [np.flatnonzero(group == number) for number in np.unique(group)]
        grouped = np.stack([signals[:, some].sum(axis=1) for some in members], axis=1)
        means = np.array([signals[:, some].sum(axis=0) @ own[some] for some in members]) / grouped.sum(axis=0)
        quanta.append(_quanta(grouped, left @ (weights[c] * energies.nodes), means, (seen[0], seen[-1])))
        channels += [c] * len(members)
        order += [first + some for some in members]
        starts += [len(some) for some in members]
    nodes = np.concatenate(order)
    names = tuple(f"group{i}" for i in range(len(channels)))
    signals = Transmission(transmission.columns[:, nodes], transmission.weights[nodes], np.cumsum(starts), names)
    return PhotonGroups(signals, np.array(channels), np.concatenate(quanta))


def _rays_of_box(lengths: Float[np.ndarray, "ray column"]) -> Float[np.ndarray, "fewer_rays column"]:
    """Rays with some part of the extreme lengths in each material, from none of all to all of all."""
    rng = np.random.default_rng(0)
    low, high = (_MARGIN * bound for bound in (lengths.min(axis=0, initial=0.0), lengths.max(axis=0, initial=0.0)))
    parts = rng.random((_GROUP_RAYS, lengths.shape[1]))
    inside = np.linspace(0.0, 1.0, _GROUP_RAYS)[:, None] * (low + parts * (high - low))
    return np.concatenate([inside, [low, high]])


def _quanta(
    signals: Float[np.ndarray, "ray group"],
    variance: Float[np.ndarray, " ray"],
    means: Float[np.ndarray, " group"],
    limits: tuple[float, float],
) -> Float[np.ndarray, " group"]:
    """Signals of one photon of each group [keV], whose sum has the variance of each ray; near the means of groups."""
    lit = variance > _DARK * variance.max()
    signals, variance = signals[lit], variance[lit]
    share = np.sqrt(_TO_NODES * len(signals) * (signals / signals.sum(axis=1, keepdims=True)).mean(axis=0))
    system = np.concatenate([signals / variance[:, None], np.diag(share / means)])
    bounds = (1 - _ROUNDING) * limits[0], (1 + _ROUNDING) * limits[1]  # apart for a single energy, too
    return lsq_linear(system, np.concatenate([np.ones(len(signals)), share]), bounds=bounds).x


def node_energies(
    scan: Scan, transmission: Transmission, rows: Int64[np.ndarray, " channel"], cuts: Float[np.ndarray, " cut"]
) -> Float[np.ndarray, " node"]:
    """Find the energy of each node: that of the bin whose attenuation is closest to that of the node.

    Where nodes were chosen without refinement, it is the one they were chosen from. Energies at which all materials
    have equal attenuation cannot be separated, and need not be.

    Parameters
    ----------
    scan : what is simulated
    transmission : with few nodes
    rows : channel of the detector, or group of heights that pile up, that each channel of `transmission` belongs to
    cuts : of the bins that the nodes replace [keV]

    Returns
    -------
    energies [keV]
    """
    energies, weights, _ = _rows(scan, STEP, cuts, grouped=True)
    curves = np.stack([m.attenuation(energies.nodes, scan.basis) for m in scan.scene.materials])
    found = []
    for row, (first, last) in zip(rows, pairwise(transmission.starts), strict=True):
        own, seen = transmission.columns[: len(curves), first:last], weights[row] > 0
        apart = np.abs(own[:, None] - curves[:, seen, None]) / np.maximum(curves[:, seen, None], _TINY)
        found.append(energies.nodes[seen][apart.max(axis=0).argmin(axis=0)] if last > first else np.empty(0))
    return np.concatenate(found)


def photons_behind(
    scan: Scan, lengths: Float[np.ndarray, "ray material"]
) -> tuple[Energies, Float[np.ndarray, "ray_and_air energy"]]:
    """Compute the photons that arrive along rays, and those of a ray through air, in bins of at most 1 keV.

    Parameters
    ----------
    scan : what is simulated
    lengths : path lengths of rays that meet every object [mm]

    Returns
    -------
    bins, and photons in each of them
    """
    air = np.zeros((1, lengths.shape[1]))
    rays = _with_profile_lengths(scan, np.concatenate([air, lengths[:: max(1, len(lengths) // _SPECTRUM_RAYS)]]))
    energies, photons, _ = _sampled(scan, ceil(_range(scan)), scan.basis.breaks)
    return energies, photons * np.exp(-rays @ _curves(scan, energies.nodes))


def reconstructor_spectra(scan: Scan) -> Spectra:
    """Create the spectral model that a dataset states: bins, basis functions, source and response.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    the spectral model on a coarse grid
    """
    spectra = Spectra.of(scan.source, scan.detector, scan.basis, RECONSTRUCTOR_BINS)
    profile = None
    if scan.profile is not None:
        profile = StoredProfile(scan.profile.names, scan.profile.lengths, scan.profile.attenuation(spectra.energy))
    bins = Energies(spectra.edges, spectra.energy)
    pulses = None if scan.pulses is None else PulseResponse.of(scan.pulses, bins)
    between = replace(spectra, profile=profile, dead_time=scan.dead_time, pulses=pulses)
    if not scan.cumulative:
        return between
    return replace(between.above_thresholds(), channels=tuple(f"counter{i}" for i in range(len(scan.detector))))


def material_coefficients(scan: Scan) -> Float[np.ndarray, "material basis"]:
    """Compute the coefficients of all materials in the basis.

    Compositions are fitted over the detected spectrum.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    coefficients [1/mm], (material, basis)
    """
    energies, detected = _detected(scan)
    return np.stack([m.coefficients_in(scan.basis, energies, detected) for m in scan.scene.materials])


def material_fit(scan: Scan) -> CoefficientFit:
    """Compute how well `material_coefficients` describe the materials, and over which energies.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    window of energies and error of each material
    """
    energies, detected = _detected(scan)
    errors = [m.fit_error(scan.basis, energies, detected) for m in scan.scene.materials]
    window = (scan.detector.lowest, scan.source.maximum)
    return CoefficientFit(window, FIT_WEIGHTS, np.array(errors))


def fit_warnings(scan: Scan, fit: CoefficientFit) -> list[str]:
    """Return sentences about materials that the basis cannot describe.

    Parameters
    ----------
    scan : what is simulated
    fit : errors of the materials

    Returns
    -------
    sentences
    """
    return [
        f"the basis describes material {material.name!r} with an rms relative error of {error:.0%} only: the truth of "
        "its coefficients means little; does its K edge lack a basis function, or lie below the lowest threshold?"
        for material, error in zip(scan.scene.materials, fit.errors, strict=True)
        if error > _POOR_FIT
    ]


def basis_warnings(scan: Scan) -> list[str]:
    """Return a sentence where several channels are fewer than the basis functions.

    A single channel is no spectral scan.

    Parameters
    ----------
    scan : what is simulated

    Returns
    -------
    no or one sentence
    """
    bases, channels = len(scan.basis), len(scan.detector)
    if not 1 < channels < bases:
        return []
    return [
        f"{channels} channels cannot tell the {bases} basis functions {', '.join(scan.basis.names)} apart: "
        f"fit such a scan by recon fit --bases {min(channels, 3)}, or add channels"
    ]


def _detected(scan: Scan) -> tuple[Float[np.ndarray, " energy"], Float[np.ndarray, " energy"]]:
    """Energies of bins of at most 1 keV in which photons are counted, and the open-beam counts of all channels."""
    energies, weights = _weights(scan, 1.0)
    detected = weights.sum(axis=0)
    seen = detected > 0
    return energies.nodes[seen], detected[seen]


def _range(scan: Scan) -> float:
    """Width of the energies that are counted [keV]; 1 for a single energy."""
    return max(scan.source.maximum - scan.detector.lowest, 1.0)


def _sampled(
    scan: Scan, count: int, breaks: tuple[float, ...], detector: AnyDetector | None = None
) -> tuple[Energies, Float[np.ndarray, " energy"], Float[np.ndarray, "channel energy"]]:
    """Grid, photons per bin and response, of the scan's detector if no other is given."""
    detector = scan.detector if detector is None else detector
    grid = scan.source.grid(detector.lowest, count, (*detector.breaks, *breaks))
    energies, photons = scan.source.sampled(grid)
    return energies, photons, detector.response(energies)


def _weights(
    scan: Scan, step: float, cuts: Float[np.ndarray, " cut"] = NO_CUTS, detector: AnyDetector | None = None
) -> tuple[Energies, Float[np.ndarray, "channel energy"]]:
    """Bins of `step` keV that end at every edge of the scene and at `cuts`, and open-beam counts in each."""
    low, high = scan.detector.lowest, scan.source.maximum
    edges = (edge for material in scan.scene.materials for edge in material.k_edges(low, high))
    breaks = (*scan.basis.breaks, *edges, *cuts)
    energies, photons, response = _sampled(scan, ceil(_range(scan) / step), breaks, detector)
    return energies, photons * response


def _rows(
    scan: Scan, step: float, cuts: Float[np.ndarray, " cut"], grouped: bool
) -> tuple[Energies, Float[np.ndarray, "row energy"], tuple[str, ...]]:
    """Bins, open-beam counts per bin of each channel, or of each group of heights, and their names."""
    if grouped and scan.pulses is not None:
        return *_weights(scan, step, cuts, scan.pulses), scan.pulses.names
    return *_weights(scan, step, cuts), scan.detector.names


def _curves(scan: Scan, energy: Float[np.ndarray, " energy"]) -> Float[np.ndarray, "material energy"]:
    """Attenuation of the materials, and of what makes the beam differ over the panel [1/mm]."""
    return _with_profile(scan, np.stack([m.attenuation(energy, scan.basis) for m in scan.scene.materials]), energy)


def _with_profile(
    scan: Scan, columns: Float[np.ndarray, "column energy"], energy: Float[np.ndarray, " energy"]
) -> Float[np.ndarray, "column_and_part energy"]:
    """Columns, and the curves of the beam's profile after them."""
    return columns if scan.profile is None else np.concatenate([columns, scan.profile.attenuation(energy)])


def _with_profile_lengths(
    scan: Scan, lengths: Float[np.ndarray, "ray material"]
) -> Float[np.ndarray, "ray_and_pixel material_and_part"]:
    """Rays through objects, each on its way to some pixel, and rays without objects to the most extreme pixels."""
    if scan.profile is None:
        return lengths
    parts = scan.profile.lengths.reshape(len(scan.profile.names), -1).T
    pixels = np.random.default_rng(0).integers(len(parts), size=len(lengths))
    extreme = parts[[*parts.argmin(axis=0), *parts.argmax(axis=0)]]
    empty = np.zeros((len(extreme), lengths.shape[1]))
    return np.concatenate([np.hstack([lengths, parts[pixels]]), np.hstack([empty, extreme])])


def _compress(
    fine: Transmission, integrals: Float[np.ndarray, "ray column"], tolerance: float, refine: bool
) -> tuple[Transmission, float]:
    """Fewer nodes for the box that `integrals` span."""
    if len(fine.columns) > _MOST_COLUMNS:
        return _compress_many(fine, integrals, tolerance, refine)
    low, high = (_MARGIN * bound for bound in (integrals.min(axis=0, initial=0.0), integrals.max(axis=0, initial=0.0)))
    return fine.compress(low, high, tolerance, refine=refine)


def _compress_many(
    fine: Transmission, integrals: Float[np.ndarray, "ray column"], tolerance: float, refine: bool
) -> tuple[Transmission, float]:
    """Compress by a few columns that the others are combinations of, else by a choice of bins."""
    sample = integrals[:: max(1, len(integrals) // _SPANNING_RAYS)]
    picked, mixture, _ = interpolative_decomposition(fine.columns, sample, tolerance / 3)
    if len(picked) > _MOST_SPANNING:
        return fine.choose(np.concatenate([sample, _MARGIN * sample]), tolerance)
    few = Transmission(fine.columns[picked], fine.weights, fine.starts, fine.channel_names)
    along = integrals @ mixture
    low, high = (_MARGIN * bound for bound in (along.min(axis=0, initial=0.0), along.max(axis=0, initial=0.0)))
    small, error = few.compress(low, high, tolerance, refine=refine)
    columns = mixture @ small.columns
    if len(small.weights) == len(fine.weights) or columns.min() < 0:
        return fine, 0.0
    found = Transmission(columns, small.weights, small.starts, small.channel_names)
    missed = np.abs(found.log_projection(sample) - fine.log_projection(sample)).max(initial=0.0)
    return found, max(error, float(missed))
