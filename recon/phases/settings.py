"""Numbers that steer the fit of phases."""

from dataclasses import dataclass

from recon.gaussians.settings import check_positive


@dataclass(frozen=True)
class PhaseSettings:
    """How phases are fitted; values without a measurement were chosen by hand.

    Momentum and coupling were compared on `perfusion` with 12 sweeps, by the mean PSNR of iodine over its phases:
    35.2 dB with 0.93 and 3, 36.0 with 0.93 and 1, 36.3 with 0.95, 0.3 and a noise of 4; 36.1 with 0.8 and 3 in 20
    sweeps; all of these without first coefficients of their own.

    Parameters
    ----------
    passes : passes over the voxels that a phase starts from, more with few views; 0 to start from all views
    change : variance over the phases, over that of noise, at which voxels keep half of their difference from the mean
        of all phases [no unit]; in phase 0 of `perfusion`, voxels have 41.7 / 42.9, 42.3 / 43.1 and 42.6 / 42.0 dB in
        Compton scattering / iodine with 64, 256 and 1024, and 40.9 / 42.6 without
    evaluations : of the fit of the shared Gaussians to the mean of all phases
    solves : steps of conjugate gradients that give their change to the coefficients
    trust : information of the first coefficients of a phase over that of its data [no unit]; 0.3 in 20 sweeps is up to
        0.5 dB better than 1 in 10 on `perfusion` and `breathing-torso`
    sweeps : times that every view is used
    steps : steps of a phase in one sweep, each with as many of its views
    coefficient_rate : step of the coefficients over that of Newton's method with the separable curvature [no unit]
    momentum : part of the last step of the coefficients that goes into the next [no unit]
    coupling : information of the coupling of neighbouring phases over that of the data of a phase, where their
        difference is not larger than noise [no unit]
    noise : differences of this many times the median of all are half as coupled [no unit]
    spacing : distance between nodes of the displacement [voxels]
    first_shift, last_shift : length of the first and of the last step of a node [voxels]
    stiffness : part of the difference from the mean of the neighbouring nodes, and from the neighbouring phases, that a
        step takes away [no unit]
    """

    passes: int = 4
    change: float = 256.0
    evaluations: int = 30
    solves: int = 20
    trust: float = 0.3
    sweeps: int = 20
    steps: int = 5
    coefficient_rate: float = 1.0
    momentum: float = 0.93
    coupling: float = 0.3
    noise: float = 4.0
    spacing: float = 6.0
    first_shift: float = 0.1
    last_shift: float = 0.005
    stiffness: float = 0.02

    def __post_init__(self) -> None:
        check_positive(self, "phases", others=("passes", "trust"))
