"""Numba kernels: the numbers of divided Gaussians seen in a view, and the chain rule from sums over pixels."""

import math
from typing import no_type_check

import numpy as np
from numba import njit

from recon.ops.interface.table import OFFSET, Q1, WIDTH
from recon.ops.rasterize.cpu import SCRATCH, backpropagate, project_centre, write_footprint
from recon.ops.rasterize.footprint_table import cross, dot
from recon.ops.rasterize.near_field import HIDDEN, NEAR, classify

# Where the values of a plane seen in a view are: those before the pixel averages them, then those after that.
SLOPE_X, SLOPE_Y, BEND_XX, BEND_XY, BEND_YY, LEAN_X, LEAN_Y = range(7)
S_XX, S_XY, S_YY = range(7, 10)  # C (C + V)^-1, by which the average shrinks them
FIRST = 10  # Q1 to Q5, B0 to B2 and the variance that the pixel adds to WIDTH, in the order of the table
VALUES = 19


@njit(inline="always", error_model="numpy")
@no_type_check
def _measure_plane(w, box, k):
    """Compute the numbers of the plane in one view.

    Parameters
    ----------
    w : vectors of `project_centre`
    box : variance that the pixel adds [pixel^2]
    k : written, (VALUES,)
    """
    u, vx, vy, a, b, v = w[1], w[2], w[3], w[4], w[5], w[6]
    depth, d0 = w[7, 2], w[10, 0]
    ux, uy, square, root = dot(u, vx), dot(u, vy), dot(u, u), math.sqrt(d0)
    slope_x = (vx[2] * square - u[2] * ux) / (depth * d0)
    slope_y = (vy[2] * square - u[2] * uy) / (depth * d0)
    bend_xx = (vx[2] * ux - u[2] * dot(vx, vx)) / d0
    bend_xy = (0.5 * (vx[2] * uy + vy[2] * ux) - u[2] * dot(vx, vy)) / d0
    bend_yy = (vy[2] * uy - u[2] * dot(vy, vy)) / d0
    lean_x, lean_y = vx[2] / root, vy[2] / root
    m11, m12, m22 = 1 + box * dot(a, a) / d0, box * dot(a, b) / d0, 1 + box * dot(b, b) / d0
    det = m11 * m22 - m12 * m12
    sxx, sxy, syy = m22 / det, -m12 / det, m11 / det
    k[SLOPE_X], k[SLOPE_Y], k[BEND_XX], k[BEND_XY], k[BEND_YY] = slope_x, slope_y, bend_xx, bend_xy, bend_yy
    k[LEAN_X], k[LEAN_Y], k[S_XX], k[S_XY], k[S_YY] = lean_x, lean_y, sxx, sxy, syy
    f11, f12, f21, f22 = (
        sxx * bend_xx + sxy * bend_xy, sxx * bend_xy + sxy * bend_yy,
        sxy * bend_xx + syy * bend_xy, sxy * bend_xy + syy * bend_yy,
    )  # fmt: skip
    q1, q2 = sxx * slope_x + sxy * slope_y, sxy * slope_x + syy * slope_y
    k[FIRST], k[FIRST + 1] = q1, q2
    k[FIRST + 2], k[FIRST + 3], k[FIRST + 4] = f11 * sxx + f12 * sxy, 2 * (f11 * sxy + f12 * syy), f21 * sxy + f22 * syy
    k[FIRST + 5], k[FIRST + 6], k[FIRST + 7] = v[2] / root, sxx * lean_x + sxy * lean_y, sxy * lean_x + syy * lean_y
    k[FIRST + 8] = box * (slope_x * q1 + slope_y * q2)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def footprints(shapes, view, sampling, rows, part, written, near):
    """Compute the numbers of some Gaussians in one view.

    Parameters
    ----------
    shapes : `recon.ops.interface.arrays.Shapes`
    view : `recon.ops.arguments.RayFrame`
    sampling : `recon.ops.rasterize.projector.PixelSampling`
    rows : of the panel
    part : first Gaussian, and one past the last
    written : `recon.ops.interface.arrays.Footprints`
    near : written, whether a Gaussian comes near the source or the panel, and has no footprint therefore

    Notes
    -----
    The mean over a pixel of variance V has, for a footprint of covariance C, the centre of mass C (C + V)^-1 x of the
    Gaussian's part in the pixel, and the variance C - C (C + V)^-1 C there. So z is taken at that point, and the
    variance of its numerator is added under its root.
    """
    centres, _, matrices, planes = shapes
    out, spans = written
    w, k, k2 = np.zeros((SCRATCH, 3)), np.empty(VALUES), sampling.cutoff * sampling.cutoff
    for g in range(part[0], part[1]):
        spans[g, 0] = spans[g, 1] = 0
        kind = classify(centres[g], matrices[g], view, k2)
        near[g] = kind == NEAR
        if kind in (HIDDEN, NEAR):
            continue
        if not project_centre(centres[g], matrices[g], view.frame, view.inverse, sampling.box, False, w):
            continue
        low, high = write_footprint(w, sampling.box, k2, rows, out[g])
        if not high > low:
            continue
        spans[g, 0], spans[g, 1] = int(low), int(high)
        _measure_plane(w, sampling.box, k)
        out[g, OFFSET], out[g, WIDTH] = planes[g, 0], planes[g, 1] * planes[g, 1] + k[FIRST + 8]
        for i in range(8):
            out[g, Q1 + i] = k[FIRST + i]


@njit(inline="always", error_model="numpy")
@no_type_check
def _backpropagate_plane(w, k, box, s, matrix, view, to_centre, to_matrix):
    """Add the gradients in centre and whitening matrix by way of the plane: `_measure_plane` in reverse.

    Parameters
    ----------
    w : vectors of `project_centre`
    k : values of `_measure_plane`
    box : variance that the pixel adds [pixel^2]
    s : sums over pixels of `recon.ops.interface.cpu.backward`
    matrix : whitening matrix [1/mm]
    view : `recon.ops.arguments.RayFrame`
    to_centre, to_matrix : added to, (3,) and (3, 3)

    Notes
    -----
    The gradient in the entry xy of a symmetric matrix is half of that in both its places.
    """
    u, vx, vy, a, b, v = w[1], w[2], w[3], w[4], w[5], w[6]
    xc, yc, depth, d0 = w[7, 0], w[7, 1], w[7, 2], w[10, 0]
    sxx, sxy, syy = k[S_XX], k[S_XY], k[S_YY]
    slope_x, slope_y, lean_x, lean_y = k[SLOPE_X], k[SLOPE_Y], k[LEAN_X], k[LEAN_Y]
    bxx, bxy, byy = k[BEND_XX], k[BEND_XY], k[BEND_YY]
    q1, q2, q3, q4, q5, tilt, b1, b2 = k[FIRST : FIRST + 8]
    to_q, to_q1, to_q2, to_q3, to_q4, to_q5, to_b0, to_b1, to_b2, to_width = s[13:23]
    # S bend S with the gradient G: S G S for the bend, G S bend + bend S G for S
    f11, f12, f21, f22 = (
        sxx * to_q3 + sxy * to_q4, sxx * to_q4 + sxy * to_q5, sxy * to_q3 + syy * to_q4, sxy * to_q4 + syy * to_q5,
    )  # fmt: skip
    to_bxx, to_bxy, to_byy = f11 * sxx + f12 * sxy, f11 * sxy + f12 * syy, f21 * sxy + f22 * syy
    to_sxx, to_syy = 2 * (f11 * bxx + f21 * bxy), 2 * (f12 * bxy + f22 * byy)
    to_sxy = (f11 * bxy + f21 * byy) + (f12 * bxx + f22 * bxy)
    # S slope, S lean, and the variance box slope^T S slope
    spread = box * to_width
    to_slope_x, to_slope_y = sxx * to_q1 + sxy * to_q2 + 2 * spread * q1, sxy * to_q1 + syy * to_q2 + 2 * spread * q2
    to_lean_x, to_lean_y = sxx * to_b1 + sxy * to_b2, sxy * to_b1 + syy * to_b2
    to_sxx += (to_q1 + spread * slope_x) * slope_x + to_b1 * lean_x
    to_sxy += 0.5 * (to_q1 * slope_y + to_q2 * slope_x + to_b1 * lean_y + to_b2 * lean_x) + spread * slope_x * slope_y
    to_syy += (to_q2 + spread * slope_y) * slope_y + to_b2 * lean_y
    # S = (1 + box P)^-1 with the precision P = (a, b)^T (a, b) / D0
    g11, g12, g21, g22 = (
        sxx * to_sxx + sxy * to_sxy, sxx * to_sxy + sxy * to_syy,
        sxy * to_sxx + syy * to_sxy, sxy * to_sxy + syy * to_syy,
    )  # fmt: skip
    scale = -box / d0
    to_p11, to_p12, to_p22 = (
        scale * (g11 * sxx + g12 * sxy),
        scale * (g11 * sxy + g12 * syy),
        scale * (g21 * sxy + g22 * syy),
    )
    # divisions by D0 and depth
    to_d0 = -(to_p11 * dot(a, a) + 2 * to_p12 * dot(a, b) + to_p22 * dot(b, b))
    to_d0 -= to_bxx * bxx + 2 * to_bxy * bxy + to_byy * byy + to_slope_x * slope_x + to_slope_y * slope_y
    to_d0 = (to_d0 - 0.5 * (to_lean_x * lean_x + to_lean_y * lean_y + to_b0 * tilt)) / d0
    to_depth = -(to_slope_x * slope_x + to_slope_y * slope_y) / depth
    to_bxx, to_bxy, to_byy = to_bxx / d0, to_bxy / d0, to_byy / d0
    to_slope_x, to_slope_y = to_slope_x / (depth * d0), to_slope_y / (depth * d0)
    root = math.sqrt(d0)
    to_lean_x, to_lean_y, to_tilt = to_lean_x / root, to_lean_y / root, to_b0 / root
    # the inner products u . vx, u . vy and u . u, and the third components of u, vx and vy
    ux, uy, square = dot(u, vx), dot(u, vy), dot(u, u)
    to_ux = to_bxx * vx[2] + to_bxy * vy[2] - to_slope_x * u[2]
    to_uy = to_bxy * vx[2] + to_byy * vy[2] - to_slope_y * u[2]
    to_square = to_slope_x * vx[2] + to_slope_y * vy[2]
    t = w[15:]  # gradients in u, vx and vy; then in a and b
    for i in range(3):
        t[3, i] = 2 * (to_p11 * a[i] + to_p12 * b[i])
        t[4, i] = 2 * (to_p12 * a[i] + to_p22 * b[i])
    cross(vx, t[3], t[0])
    cross(vy, t[4], t[5])
    cross(t[3], u, t[1])
    cross(t[4], u, t[2])
    for i in range(3):
        to_v = 2 * to_d0 * v[i]
        if i == 2:
            to_v += to_tilt
        to_depth -= to_v * v[i] / depth
        t[0, i] += t[5, i] + to_v / depth + 2 * to_square * u[i] + to_ux * vx[i] + to_uy * vy[i]
        t[1, i] += to_ux * u[i] - 2 * u[2] * (to_bxx * vx[i] + to_bxy * vy[i])
        t[2, i] += to_uy * u[i] - 2 * u[2] * (to_bxy * vx[i] + to_byy * vy[i])
    t[0, 2] -= (
        to_bxx * dot(vx, vx) + 2 * to_bxy * dot(vx, vy) + to_byy * dot(vy, vy) + to_slope_x * ux + to_slope_y * uy
    )
    t[1, 2] += to_bxx * ux + to_bxy * uy + to_slope_x * square + to_lean_x
    t[2, 2] += to_bxy * ux + to_byy * uy + to_slope_y * square + to_lean_y
    # the projected centre, from which the x and y of Q and B are counted
    to_xc = -(q1 * to_q + 2 * q3 * to_q1 + q4 * to_q2) - b1 * to_b0
    to_yc = -(q2 * to_q + q4 * to_q1 + 2 * q5 * to_q2) - b2 * to_b0
    to_depth -= (xc * to_xc + yc * to_yc) / depth
    for j in range(3):
        to_centre[j] += (to_xc * view.inverse[0, j] + to_yc * view.inverse[1, j]) / depth + to_depth * view.inverse[
            2, j
        ]
        for i in range(3):
            to_centre[j] += matrix[i, j] * t[0, i]
            to_matrix[i, j] += t[0, i] * w[0, j] + t[1, i] * view.frame[2, j] + t[2, i] * view.frame[3, j]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(shapes, view, box, spans, sums, part, gradients):
    """Add the gradients of some Gaussians, from the sums over their pixels in one view.

    Parameters
    ----------
    shapes, view : as in `footprints`
    box : variance that the pixel adds [pixel^2]
    spans : rows of each footprint, of `footprints`
    sums : of `recon.ops.interface.cpu.backward`
    part : first Gaussian, and one past the last
    gradients : `recon.ops.interface.arrays.ShapeGradients`, added to
    """
    centres, _, matrices, planes = shapes
    to_centres, to_matrices, to_planes = gradients
    w, k = np.zeros((SCRATCH, 3)), np.empty(VALUES)
    for g in range(part[0], part[1]):
        if spans[g, 1] <= spans[g, 0]:
            continue
        project_centre(centres[g], matrices[g], view.frame, view.inverse, box, False, w)
        _measure_plane(w, box, k)
        s = sums[g]
        to_planes[g, 0] += s[12]
        to_planes[g, 1] += 2 * planes[g, 1] * s[22]
        _backpropagate_plane(w, k, box, s, matrices[g], view, to_centres[g], to_matrices[g])
        backpropagate(w, s, False, matrices[g], view.frame, view.inverse, to_centres[g], to_matrices[g])
