"""Photon transport: energy that photons of all orders of scattering leave in voxels, by Monte Carlo.

Photons fly by delta tracking (Woodcock et al. 1965): flights end at tentative collisions of the largest attenuation
coefficient of the medium, of which those beyond the coefficient of the place do not count. At each tentative collision
of a photon of energy E and weight w, whether it counts or not, the voxel is given w E mu_tr(E) / mu_largest, the
expected energy transferred to electrons, which stay where they are; a probe is given air kerma in the same way.
Rayleigh scattering follows form factors, Compton scattering Klein and Nishina's formula times incoherent scattering
functions; an absorbed photon ends there, without fluorescence.
"""

from phantomgen.ops.photon_transport.inputs import Beam, Crossings, Deposits, Medium, Probes


def transport(count: int, seed: int, beam: Beam, medium: Medium, crossings: Crossings, probes: Probes) -> Deposits:
    """Follow photons from the source until they are absorbed or leave the voxels.

    Parameters
    ----------
    count : number of photons
    seed : of their random numbers; the same seed gives the same bits
    beam : where they come from
    medium : what they meet
    crossings : what happens to them there
    probes : cylinders in which energy and air kerma are summed

    Returns
    -------
    what all of them leave together
    """
    from phantomgen.ops.photon_transport.cpu import follow  # noqa: PLC0415 - numba only where it computes

    deposits = Deposits.empty(medium, probes)
    follow(count, seed, beam, medium, crossings, probes, deposits)
    return deposits
