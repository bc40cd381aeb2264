"""Cases of ``recon stress`` that need no scan."""

from phantomgen.stress.case import Case
from recon.stress import decomposition, projector

_PEAK = "error over the largest line integral"
_STATISTICAL = 4.0  # standard errors; by chance in 1 of 16,000 draws
CASES = (
    Case("needles", "long Gaussians", "length over width", _PEAK, 1e-5, projector.needles),
    # a thin disc that is seen along its plane: rounding of float32 grows with the ratio
    Case("discs", "flat Gaussians", "width over thickness", _PEAK, 1e-4, projector.discs),
    Case("wide", "Gaussians wider than the panel", "standard deviation [pixel]", _PEAK, 1e-5, projector.wide),
    Case("source", "a Gaussian around the source", "distance [std. dev.]", _PEAK, 1e-5, projector.around_the_source),
    Case("distant", "a source far away", "distance [mm]", _PEAK, 1e-5, projector.distant_source),
    # the sum over the lattice is corrected to its nearest harmonics: 0.3 % per axis is left for the narrowest
    Case(
        "narrow", "Gaussians within a pixel", "standard deviation [pixel]", "relative error", 0.0095, projector.narrow
    ),
    Case(
        "narrow-voxel",
        "Gaussians within a voxel",
        "standard deviation [voxel]",
        "relative error",
        0.014,
        projector.narrow_in_voxels,
    ),
    Case("few-pixels", "panels of few pixels", "pixels", _PEAK, 1e-5, projector.few_pixels),
    # a box counts as a Gaussian of its variance: an error of (edge / sigma)^4 / 960 per axis is left
    Case("one-voxel", "a single flat voxel", "ratio of edges", "relative error", 2e-4, projector.one_voxel),
    Case("photons", "few photons", "photons", "error of line integrals", 1e-4, decomposition.few_photons),
    Case(
        "lost",
        "channels without counts",
        "channels",
        "error of line integrals",
        1e-4,
        decomposition.channels_without_counts,
    ),
    Case("near-edges", "two near K edges", "distance [keV]", "error [std. dev.]", 0.01, decomposition.two_near_edges),
    Case(
        "threshold",
        "no threshold at the edge",
        "distance [keV]",
        "error [std. dev.]",
        0.01,
        decomposition.distant_threshold,
    ),
    Case("faint", "faint iodine", "iodine [mg/ml]", "bias [std. err.]", _STATISTICAL, decomposition.faint_contrast),
    # 40,000 draws give a standard deviation to 0.35 %
    Case("efficiency", "noise of iodine", "iodine [mg/ml]", "std. dev. over bound", 0.0145, decomposition.efficiency),
)
