"""Codes of the unit primitives that every analytic shape is an affine image of.

==========  ====================================
code        region in local coordinates
==========  ====================================
`BALL`      x^2 + y^2 + z^2 < 1
`CYLINDER`  x^2 + y^2 < 1 and -1 <= z < 1
`BOX`       -1 <= x, y, z < 1
==========  ====================================

Flat faces are half open, so that of two shapes that touch in a plane exactly one owns a ray that runs inside it.
"""

BALL = 0
CYLINDER = 1
BOX = 2
