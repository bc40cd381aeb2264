"""Where the numbers of a divided Gaussian seen in a view are; the first 11 are those of a plain footprint.

In pixels (x, y) from the projected centre, with E as in `recon.ops.rasterize.cpu`, the part on the positive side is
Phi(z), z = (-OFFSET E + Q) / sqrt(E (WIDTH E + B^2)),
Q = Q1 x + Q2 y + Q3 x^2 + Q4 x y + Q5 y^2,  B = B0 + B1 x + B2 y.
"""

XC, YC, L11, L21, L22, E1, E2, E3, E4, E5, AMPLITUDE = range(11)
OFFSET, Q1, Q2, Q3, Q4, Q5, B0, B1, B2, WIDTH = range(11, 21)
NUMBERS = 21
SUMS = 23  # of the backward pass: 12 of a plain footprint, 1 of OFFSET, 6 of Q, 3 of B, 1 of WIDTH
