"""What may differ by how much, and why: one table for the tests of the reconstructor, not softened to make one pass."""

TOLERANCES = {
    # float32 pixels, exp to 1e-6, and tails cut off at 5 standard deviations (3.7e-6 of a peak); measured 5e-6
    "kernel_value": 3e-5,
    # the same cut in gradients, whose tails are heavier by the square of 5 standard deviations; measured 1.2e-4
    "kernel_gradient": 5e-4,
    # float32 near an outline, where the slope of a chord is largest; measured 5e-6 and 1e-4
    "chord_value": 2e-5,
    "chord_gradient": 4e-4,
    # 64 points per voxel tell how full it is
    "filled_mass": 5e-3,
    # tails beyond the default 3.7 standard deviations are exp(-6.8) = 1.07e-3 of a peak
    "rasterize_truncation": 1.1e-3,
    # tails beyond the default 4.5 standard deviations are exp(-10.1) = 4e-5 of a peak
    "voxelize_truncation": 4.1e-5,
    # closed form against the trapezoidal rule with ten steps per standard deviation, both in float64
    "quadrature": 1e-9,
    # sums of some thousand float32 numbers
    "float32_sums": 3e-6,
    # closed form in the kernel against the same rule: `kernel_value` without the cut
    "quadrature_kernel": 1e-5,
    # lattice harmonics beyond the nearest neighbours: 2 exp(-8 pi^2 / 12) / 0.61 = 0.45 % per axis, narrowest footprint
    "narrow_pixel_mass": 0.0095,
    "narrow_voxel_mass": 0.014,
    # Fisher scoring stops at steps of 1e-4 and converges linearly with a small factor; scipy stops at 1e-8
    "decompose_maximum": 2e-4,
    # 4000 samples give the standard deviation to 1.1 %; four of those
    "efficiency": 0.045,
    # float32 sums over views
    "backproject": 1e-5,
    # ramp filter sampled at the pixel pitch, 120 views of Gaussians that are 5 pixels wide
    "fdk_scale": 0.02,
    # blobs of 2.5 mm on pixels of 1 mm: linear interpolation on panels that look elsewhere; measured 2e-4 to 7e-3
    "fdk_other_orbits": 8e-3,
    # dB by which RTK may be better; measured 0.06 to 0.29
    "fdk_rtk": 0.3,
    # a few iterations with float32 projections against float64 matrices; measured 1e-6
    "iterative": 2e-5,
    # float64 formulas against scipy.stats, whose log gamma cancels at counts of 1e5
    "deviance": 1e-7,
    # float32 projections inside
    "curvature": 1e-4,
    # float32 line integrals and counts, sums in float64
    "likelihood": 1e-5,
    # float32 sums of differences
    "total_variation": 1e-5,
}
