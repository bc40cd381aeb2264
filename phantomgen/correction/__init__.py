"""What a raw scan needs before it is reconstructed: bad pixels, tube output, and gains of pixels, from the scan itself.

Counts stay as they are: masks, the exposure of views and the flats change, so that the noise of counts stays that of
photons. Functions of arrays in `bad_pixels`, `tube_output` and `pixel_gains`; `sums` reads a dataset, `run` writes one.
"""
