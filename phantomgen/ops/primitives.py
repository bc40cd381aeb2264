"""Codes of the unit primitives that every analytic shape is made of, each under an affine map.

==========  ====================================================================
code        region in local coordinates
==========  ====================================================================
`BALL`      x^2 + y^2 + z^2 < 1
`CYLINDER`  x^2 + y^2 < 1 and -1 <= z < 1
`BOX`       -1 <= x, y, z < 1
`CONE`      x^2 + y^2 < z^2 and 0 <= z < 1
`HALFSPACE` z < 0
`TORUS`     (sqrt(x^2 + y^2) - 1 + r)^2 + z^2 < r^2, r < 1/2 the radius of the tube
`MESH`      inside a closed triangle mesh, kept apart, whose bounds are the box -1 .. 1
==========  ====================================================================

Flat faces are half open, so that of two shapes that touch in a plane exactly one owns a ray that runs inside it. All
but the half-space lie in the cube -1 .. 1.
"""

BALL = 0
CYLINDER = 1
BOX = 2
CONE = 3
HALFSPACE = 4
TORUS = 5
MESH = 6
