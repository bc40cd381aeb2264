"""Published methods that are networks: attenuation as a function of the place, fitted to rays that are sampled.

`rays` picks rays and points on them, `networks` holds what maps points to attenuation, `training` the loop. A file
each: `field` (in the manner of IntraTomo and NAF) and `sax_nerf` (in the manner of SAX-NeRF), which say what is
simplified.
"""
