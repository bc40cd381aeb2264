"""Published methods that are networks: attenuation as a function of position, fitted to sampled rays.

`rays` chooses rays and points on them, `networks` computes attenuation from positions, `training` has the settings and
the loop that all share. Each method has a file, which names its article and what is simplified: `naf` (NAF and
IntraTomo) and `sax_nerf` (SAX-NeRF).
"""
