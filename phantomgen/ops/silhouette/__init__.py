"""Where, on a plane of rays, path lengths through a shape are not smooth, and how to integrate over a pixel there.

Rays that touch a ball or the mantle of a cylinder, or that pass through the rim of a cylinder or the edge of a box,
form conics on the panel: exactly ``q(u, v) = 0`` with a quadratic q (`forms`). Those that touch a torus nearly do so
within each pixel (`rings`). Averages over a pixel are exact to the order of a Gauss rule when the pixel is split along
them (`quadrature`).
"""
