"""Published methods that splat: one set of primitives per channel or basis, fitted by Adam as in R2-Gaussian.

`primitives` has the kinds of primitive, `training` the settings and the loop that all share, `volume_method` what the
methods with a volume share. Each method has a file, which names its article and what is simplified: `r2_gaussian`,
`x_field`, and `x_gaussian`, which has no volume.
"""
