"""The two energy grids of a scan: a fine one to simulate with, a coarse one to tell the reconstructor.

The simulator works on attenuation curves of materials, exact ones where a composition is given; the reconstructor
only gets bins and basis functions. Where all materials are explicit coefficients, nodes are sought in the space of
basis functions, which has fewer dimensions, and then translated.
"""

from math import ceil

import numpy as np
from jaxtyping import Float

from phantomgen.dataset import Spectra
from phantomgen.dataset_truth import CoefficientFit
from phantomgen.scene import Scan
from spectra.energies import Energies
from spectra.spanning import spanning_columns
from spectra.transmission import Transmission

# Bin width of the simulator [keV], and the worst error of log counts that its nodes may add.
STEP = 0.125
TOLERANCE = 1e-5
RECONSTRUCTOR_BINS = 128
FIT_WEIGHTS = "open-beam counts of all channels together, in bins of at most 1 keV"
# Worse fits [relative rms] are said aloud; those of tissues, plastics and metals up to iron stay below 2 %.
_POOR_FIT = 0.05
# Above so many columns the search for nodes samples its box too thinly: then it goes by way of fewer columns, as most
# materials are combinations of a few, and keeps all bins where even these are too many.
_MOST_COLUMNS = 6
_MOST_SPANNING = 8
_SPANNING_RAYS = 2000
# Sampled rays may miss the longest path of all.
_MARGIN = 1.1


def fine_transmission(scan: Scan, step: float = STEP) -> Transmission:
    """Path lengths per material [mm] to expected counts, on bins of `step` keV."""
    energies, weights = _weights(scan, ceil(_range(scan) / step))
    return Transmission.from_spectrum(weights, _curves(scan, energies), scan.detector.names)


def compressed_transmission(
    scan: Scan,
    lengths: Float[np.ndarray, "ray material"],
    step: float = STEP,
    tolerance: float = TOLERANCE,
    refine: bool = True,
) -> tuple[Transmission, float]:
    """The same with few nodes.

    Parameters
    ----------
    scan : what is simulated
    lengths : path lengths of rays that meet every object [mm]; they span the box of what can be reached
    step : bin width before nodes are sought [keV]
    tolerance : worst error of log counts that is wanted
    refine : whether nodes are merged and moved, for the fewest of them, or chosen only

    Returns
    -------
    the transmission, and the worst error of log counts that was found on fresh rays of the box
    """
    materials = scan.scene.materials
    if any(m.composition is not None for m in materials) or len(materials) <= len(scan.basis):
        return _compress(fine_transmission(scan, step), lengths, tolerance, refine)
    energies, weights = _weights(scan, ceil(_range(scan) / step))
    fine = Transmission.from_spectrum(weights, scan.basis.evaluate(energies.nodes), scan.detector.names)
    coefficients = material_coefficients(scan)
    small, error = _compress(fine, lengths @ coefficients, tolerance, refine)
    return Transmission(coefficients @ small.columns, small.weights, small.starts, small.channel_names), error


def reconstructor_spectra(scan: Scan) -> Spectra:
    """What a dataset tells about energies: bins, basis functions, source and response."""
    energies, source, response = _sampled(scan, RECONSTRUCTOR_BINS, scan.basis.breaks)
    return Spectra(
        energy=energies.nodes,
        edges=energies.edges,
        source=source,
        response=response,
        basis=scan.basis,
        basis_values=scan.basis.evaluate(energies.nodes),
        channels=scan.detector.names,
        lower=np.array([channel.lower for channel in scan.detector.channels]),
        upper=np.array([channel.upper for channel in scan.detector.channels]),
    )


def material_coefficients(scan: Scan) -> Float[np.ndarray, "material basis"]:
    """Coefficients of all materials in the basis [1/mm]; for compositions fitted over the detected spectrum."""
    energies, detected = _detected(scan)
    return np.stack([m.coefficients_in(scan.basis, energies, detected) for m in scan.scene.materials])


def material_fit(scan: Scan) -> CoefficientFit:
    """How well `material_coefficients` describe the materials, and over which energies."""
    energies, detected = _detected(scan)
    errors = [m.fit_error(scan.basis, energies, detected) for m in scan.scene.materials]
    window = (scan.detector.channels[0].lower, scan.source.maximum)
    return CoefficientFit(window, FIT_WEIGHTS, np.array(errors))


def fit_warnings(scan: Scan, fit: CoefficientFit) -> list[str]:
    """Sentences about materials that the basis cannot describe."""
    return [
        f"the basis describes material {material.name!r} with an rms relative error of {error:.0%} only: the truth of "
        "its coefficients means little; does its K edge lack a basis function, or lie below the lowest threshold?"
        for material, error in zip(scan.scene.materials, fit.errors, strict=True)
        if error > _POOR_FIT
    ]


def _detected(scan: Scan) -> tuple[Float[np.ndarray, " energy"], Float[np.ndarray, " energy"]]:
    """Energies of bins of at most 1 keV in which photons are counted, and the open-beam counts of all channels."""
    energies, weights = _weights(scan, ceil(_range(scan)))
    detected = weights.sum(axis=0)
    seen = detected > 0
    return energies.nodes[seen], detected[seen]


def _range(scan: Scan) -> float:
    """Width of the energies that are counted [keV]; 1 for a single energy."""
    return max(scan.source.maximum - scan.detector.channels[0].lower, 1.0)


def _sampled(
    scan: Scan, count: int, breaks: tuple[float, ...]
) -> tuple[Energies, Float[np.ndarray, " energy"], Float[np.ndarray, "channel energy"]]:
    """Grid, photons per bin and response."""
    grid = scan.source.grid(scan.detector.channels[0].lower, count, (*scan.detector.breaks, *breaks))
    energies, photons = scan.source.sampled(grid)
    return energies, photons, scan.detector.response(energies)


def _weights(scan: Scan, count: int) -> tuple[Energies, Float[np.ndarray, "channel energy"]]:
    """Grid that breaks at every edge of the scene, and open-beam counts per bin."""
    low, high = scan.detector.channels[0].lower, scan.source.maximum
    edges = (edge for material in scan.scene.materials for edge in material.k_edges(low, high))
    energies, photons, response = _sampled(scan, count, (*scan.basis.breaks, *edges))
    return energies, photons * response


def _curves(scan: Scan, energies: Energies) -> Float[np.ndarray, "material energy"]:
    """Attenuation of the materials [1/mm]."""
    return np.stack([m.attenuation(energies.nodes, scan.basis) for m in scan.scene.materials])


def _compress(
    fine: Transmission, integrals: Float[np.ndarray, "ray column"], tolerance: float, refine: bool
) -> tuple[Transmission, float]:
    """Fewer nodes for the box that `integrals` span."""
    if len(fine.columns) > _MOST_COLUMNS:
        return _compress_many(fine, integrals, tolerance, refine)
    high = _MARGIN * integrals.max(axis=0, initial=0.0)
    return fine.compress(np.zeros_like(high), high, tolerance, refine=refine)


def _compress_many(
    fine: Transmission, integrals: Float[np.ndarray, "ray column"], tolerance: float, refine: bool
) -> tuple[Transmission, float]:
    """The same by way of a few columns that the others are combinations of, where there are such."""
    sample = integrals[:: max(1, len(integrals) // _SPANNING_RAYS)]
    picked, mixture, _ = spanning_columns(fine.columns, sample, tolerance / 3)
    if len(picked) > _MOST_SPANNING:
        return fine, 0.0
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
