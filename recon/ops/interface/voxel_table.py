"""Where the numbers of a divided Gaussian on a grid are; lengths in voxels.

With d the offset (x, y, z) of a voxel from the centre, the square of the distance is
(u11 x + u12 y + u13 z)^2 + (u22 y + u23 z)^2 + (u33 z)^2, and the part on the positive side of the plane is
Phi(PART + PART_X x + PART_Y y + PART_Z z). A centre is the voxel that it lies in and the offset from there.
"""

X, Y, Z, U11, U12, U13, U22, U23, U33, AMPLITUDE, PART, PART_X, PART_Y, PART_Z = range(14)
NUMBERS = 14
SUMS = 14  # of the backward pass: w (1, d, d d^T), and the gradient in the argument of Phi, times (1, d)
