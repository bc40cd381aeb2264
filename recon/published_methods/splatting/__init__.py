"""Published methods that splat: one set of primitives per channel or basis, fitted by Adam as R2-Gaussian does.

`training` is the loop that they share, `look` what a primitive looks like in a view. A file each: `gaussian_mono`
(R2-Gaussian), `ellipsoid` (after X-Field) and `x_gaussian` (after X-Gaussian, which has no volume).
"""
