"""Measured values at a part of the dose, from the values that were measured.

**Counts.** If every photon of a Poisson number of mean m is kept with probability d, independently of all others, then
the kept and the other photons are two independent Poisson numbers of means d m and (1 - d) m (Kingman 1993, Poisson
Processes, chapter 5, colouring theorem). So binomial thinning of measured counts is exactly a scan of the dose d,
without approximation and without knowledge of m. Counts beside the photons, which darks show, do not depend on the
dose; what thinning takes of them is drawn anew.

**Signals.** A signal S above its dark level, of variance q S + sigma^2 (q: signal per photon; sigma: noise of the
electronics, which no dose changes), becomes

    d S + sqrt(d (1 - d) q S + (1 - d^2) sigma^2) N(0, 1),

with mean d S and variance d q S + sigma^2, as a scan of the dose d has. This is the noise insertion of the literature
on simulated low-dose CT (Benson & De Man 2010, Synthetic CT noise emulation in the raw data domain, IEEE Nuclear
Science Symposium; Zabic et al. 2013, Med. Phys. 40, 031102), and for -log of signals the formula of Yu et al. 2012,
doi:10.1097/RCT.0b013e318258e891.
"""

from hashlib import sha256

import numpy as np
from jaxtyping import Float, Integer

Image = Float[np.ndarray, "row column"]
CountImage = Integer[np.ndarray, "row column"]


def thinned(counts: Integer[np.ndarray, "..."], dose: float, random: np.random.RandomState) -> np.ndarray:
    """Keep each count with a probability.

    Parameters
    ----------
    counts : counts of any shape
    dose : the probability, 0 to 1
    random : random numbers

    Returns
    -------
    counts that are kept, int64, of the same shape; `counts` itself at dose 1
    """
    return counts.astype(np.int64) if dose == 1 else random.binomial(counts.astype(np.int64), dose).astype(np.int64)


def counts_at_dose(
    counts: CountImage, dark: Image, dose: float, complement: bool, random: np.random.RandomState
) -> CountImage:
    """Compute the counts at a part of the dose.

    Parameters
    ----------
    counts : measured counts, (row, column)
    dark : mean counts without beam, which do not depend on the dose
    dose : part of the photons that is kept
    complement : return the other photons in place of those that are kept
    random : random numbers

    Returns
    -------
    counts, int64
    """
    kept = thinned(counts, dose, random)
    if complement:
        kept = counts - kept
    lost = dark * (dose if complement else 1 - dose)
    return kept + random.poisson(lost) if lost.any() else kept


def signal_at_dose(
    signal: Float[np.ndarray, "..."],
    dark: Float[np.ndarray, "..."],
    dose: float,
    quantum: float,
    variance: float,
    random: np.random.RandomState,
) -> Float[np.ndarray, "..."]:
    """Compute the signal of an energy-integrating detector at a part of the dose, noise of the electronics included.

    Parameters
    ----------
    signal : measured signal [keV]
    dark : mean signal without beam [keV]
    dose : part of the photons
    quantum : variance over mean of the signal of photons [keV]
    variance : of the electronics [keV^2]
    random : random numbers

    Returns
    -------
    signal [keV]

    References
    ----------
    Yu et al. 2012, J. Comput. Assist. Tomogr. 36, 477, doi:10.1097/RCT.0b013e318258e891.
    """
    above = signal - dark
    added = dose * (1 - dose) * quantum * np.maximum(above, 0.0) + (1 - dose**2) * variance
    return dark + dose * above + np.sqrt(added) * random.standard_normal(np.shape(signal))


def line_integrals_at_dose(
    line_integrals: Float[np.ndarray, "..."],
    dose: float,
    air: float,
    electronics: float,
    random: np.random.RandomState,
) -> Float[np.ndarray, "..."]:
    """Add the noise of a part of the dose to log projections, for data whose counts are not at hand.

    Parameters
    ----------
    line_integrals : -log of measured signals over the open beam, no unit
    dose : part of the photons
    air : photons of the open beam at full dose, or the number of equal variance
    electronics : variance of the electronics, as a number of photons
    random : random numbers

    Returns
    -------
    log projections

    Notes
    -----
    To first order in the noise the same as `signal_at_dose`; it fails where few photons arrive.

    References
    ----------
    Yu et al. 2012, J. Comput. Assist. Tomogr. 36, 477, doi:10.1097/RCT.0b013e318258e891.
    """
    per_photon = np.exp(line_integrals) / air
    added = (1 - dose) / dose * per_photon * (1 + (1 + dose) / dose * electronics * per_photon)
    return line_integrals + np.sqrt(added) * random.standard_normal(np.shape(line_integrals))


def dose_seed(seed: int, dose: float, step: int) -> int:
    """Derive the seed of one dose and one step, so that files of several doses, or degraded twice, share no numbers.

    Parameters
    ----------
    seed : that the user gave
    dose : part of the photons, or of the pixels that die
    step : number of the step in the history of the file

    Returns
    -------
    a seed of 64 bits
    """
    return int.from_bytes(sha256(f"{seed} {float(dose).hex()} {step}".encode()).digest()[:8], "little")
