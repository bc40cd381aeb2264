"""Numba kernels for Gaussians that reach the source or the panel, where rays begin and end.

There the line integral is that of the whole line times the part that lies on the ray, and a projected centre may be at
infinity, so no coordinate here is measured from one. With u = A (p - o), v = A d, m = u x v and
J = [u x A du, u x A dv] a pixel is
    |d| amplitude / |v| exp(-m^T S m / (2 |v|^2)) (erf(z1 / sqrt 2) + erf(z0 / sqrt 2)) / 2,
where S = (1 + c J J^T)^-1 averages over the pixel (c = box depth^2 / |u|^2, see `reference.rasterize`), z0 = u.v / |v|
is the way from the source to the closest point of the ray and z1 = |v| - z0 the way on from there to the panel, both
in standard deviations and of the ray through that part of the pixel where the Gaussian is seen, -c J^T S m pixels from
its centre. All numbers are float64, which suffices for sources at 1e9 mm. Few Gaussians are near an end of the rays,
so a plain loop over pixels is fast enough.
"""

import math
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from phantomgen.ops.simd import WIDTH
from recon.ops.arguments import TINY
from recon.ops.rasterize.footprint_table import ROW_0, ROW_1, YC, apply, cross, dot, lattice_mass, row_span

HIDDEN, BETWEEN, NEAR = range(3)
REACH = 5.0  # standard deviations past the closest point of a ray where a Gaussian ends: 3e-7 of the integral are left
SCRATCH = 19  # rows of the scratch array of one Gaussian in one view
ROOT_HALF = math.sqrt(0.5)
f4 = np.float32


class _Ray(NamedTuple):
    """Vectors of one Gaussian, and scratch for those of one ray.

    Parameters
    ----------
    w : vectors of `project`; the other fields are rows of it
    u, s : u and S
    v, m, n : v, m = u x v and S m of the ray
    seen : v of the ray through the part of the pixel where the Gaussian is seen
    """

    w: Float64[np.ndarray, "19 3"]
    u: Float64[np.ndarray, "3"]
    s: Float64[np.ndarray, "3 3"]
    v: Float64[np.ndarray, "3"]
    m: Float64[np.ndarray, "3"]
    n: Float64[np.ndarray, "3"]
    seen: Float64[np.ndarray, "3"]


class _Sums(NamedTuple):
    """Sums over the pixels of one Gaussian.

    Parameters
    ----------
    vectors : gradients in u, vx, vy, A d0, the rows of S, a = u x vx and b = u x vy; then three rows of scratch
    mass : sum of values times the gradient in them
    to_c : gradient in c
    """

    vectors: Float64[np.ndarray, "12 3"]
    mass: float
    to_c: float


@njit(inline="always")
@no_type_check
def classify(centre, matrix, view, k2):
    """Decide whether a Gaussian is outside the rays, between source and panel, or near an end of the rays.

    Parameters
    ----------
    centre, matrix : of the Gaussian [mm], [1/mm]
    view : `recon.ops.arguments.RayFrame`
    k2 : square of the cutoff

    Returns
    -------
    HIDDEN where no ray meets the Gaussian, NEAR where rays meet it near the source or the panel, else BETWEEN

    Notes
    -----
    A ray that passes within the cutoff and has its end within REACH of the closest point has that end within
    `distance` of the centre. A Gaussian that lies between the planes through source and panel up to this distance is
    therefore not cut. Near the plane of the source the distance from the source itself decides, and whether the shadow
    of the Gaussian is an ellipse: if not, its projected centre may be far from the pixels that see it.
    """
    frame, inverse = view.frame, view.inverse
    square = REACH * REACH + k2
    depth, spread = 0.0, 0.0
    for i in range(3):
        depth += inverse[2, i] * (centre[i] - frame[0, i])
        along = inverse[2, 0] * matrix[i, 0] + inverse[2, 1] * matrix[i, 1] + inverse[2, 2] * matrix[i, 2]
        norm = matrix[i, 0] * matrix[i, 0] + matrix[i, 1] * matrix[i, 1] + matrix[i, 2] * matrix[i, 2]
        spread += along * along / (norm * norm)
    distance = math.sqrt(square * spread)
    if distance < depth < 1 - distance:
        return BETWEEN
    if not -distance < depth < 1 + distance:
        return HIDDEN
    if depth > 1 - distance:
        return NEAR
    w = np.empty((6, 3))
    for i in range(3):
        w[0, i] = centre[i] - frame[0, i]
    apply(matrix, w[0], w[1])
    apply(matrix, frame[2], w[2])
    apply(matrix, frame[3], w[3])
    if dot(w[1], w[1]) < square:
        return NEAR
    cross(w[1], w[2], w[4])
    cross(w[1], w[3], w[5])
    q11 = dot(w[4], w[4]) - k2 * dot(w[2], w[2])
    q12 = dot(w[4], w[5]) - k2 * dot(w[2], w[3])
    q22 = dot(w[5], w[5]) - k2 * dot(w[3], w[3])
    if not (q11 > 0 and q11 * q22 > q12 * q12):
        return NEAR
    return BETWEEN if depth > 0 else HIDDEN


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def project(centre, matrix, view, box, w):
    """Compute the vectors of one Gaussian in one view.

    Parameters
    ----------
    centre, matrix : of the Gaussian [mm], [1/mm]
    view : `recon.ops.arguments.RayFrame`
    box : variance that the pixel adds [pixel^2]
    w : written, (19, 3): 0 offset from the source, 1 u, 2 vx, 3 vy, 4 u x vx, 5 u x vy, 6 A d0, 7 (depth, c,
        amplitude), 8 to 10 S, 11 (xc, yc, unused), 12 covariance in pixels before the pixel averages, 13 and 14 the sum
        over pixels and its gradient; 15 to 18 are left to a ray: v, u x v, S (u x v), and v where the Gaussian is seen

    Returns
    -------
    False where the amplitude is not finite
    """
    frame, inverse = view.frame, view.inverse
    for i in range(3):
        w[0, i] = centre[i] - frame[0, i]
    apply(matrix, w[0], w[1])
    apply(matrix, frame[2], w[2])
    apply(matrix, frame[3], w[3])
    apply(matrix, frame[1], w[6])
    cross(w[1], w[2], w[4])
    cross(w[1], w[3], w[5])
    depth = inverse[2, 0] * w[0, 0] + inverse[2, 1] * w[0, 1] + inverse[2, 2] * w[0, 2]
    square = max(dot(w[1], w[1]), TINY)
    c = box * depth * depth / square
    h = w[8:11]
    for i in range(3):
        for j in range(3):
            h[i, j] = (1.0 if i == j else 0.0) + c * (w[4, i] * w[4, j] + w[5, i] * w[5, j])
    det = _invert(h)
    w[13:15] = 0.0
    w[13, 0] = 1.0
    w[12] = 0.0
    volume = dot(w[4], w[3])
    if depth != 0 and volume != 0:  # else so wide that pixels sample it evenly
        narrow = 1 / (depth * volume) ** 2
        w[12, 0], w[12, 1], w[12, 2] = dot(w[5], w[5]) * narrow, -dot(w[4], w[5]) * narrow, dot(w[4], w[4]) * narrow
        for k in range(2):
            w[11, k] = (inverse[k, 0] * w[0, 0] + inverse[k, 1] * w[0, 1] + inverse[k, 2] * w[0, 2]) / depth
        lattice_mass(w[11, 0], w[11, 1], w[12, 0], w[12, 1], w[12, 2], box, w[13:15].reshape(6))
    w[7, 0], w[7, 1], w[7, 2] = depth, c, math.sqrt(2 * math.pi / det) / w[13, 0]
    return math.isfinite(det) and det > 0


@njit(inline="always")
@no_type_check
def _invert(h):
    """Inverse of a symmetric matrix, in place; returns its determinant."""
    c00, c01, c02 = (
        h[1, 1] * h[2, 2] - h[1, 2] * h[1, 2],
        h[0, 2] * h[1, 2] - h[0, 1] * h[2, 2],
        h[0, 1] * h[1, 2] - h[0, 2] * h[1, 1],
    )
    c11, c12 = h[0, 0] * h[2, 2] - h[0, 2] * h[0, 2], h[0, 1] * h[0, 2] - h[0, 0] * h[1, 2]
    c22 = h[0, 0] * h[1, 1] - h[0, 1] * h[0, 1]
    det = h[0, 0] * c00 + h[0, 1] * c01 + h[0, 2] * c02
    h[0, 0], h[1, 1], h[2, 2] = c00 / det, c11 / det, c22 / det
    h[0, 1] = h[1, 0] = c01 / det
    h[0, 2] = h[2, 0] = c02 / det
    h[1, 2] = h[2, 1] = c12 / det
    return det


@njit(inline="always")
@no_type_check
def _vectors(w):
    """Name the vectors that the rays of a Gaussian need."""
    return _Ray(w, w[1], w[8:11], w[15], w[16], w[17], w[18])


@njit(inline="always")
@no_type_check
def _cast(ray, column, row):
    """Write the vectors of a pixel; returns |v|^2 and the squared distance of the ray in standard deviations."""
    w, u, s, v, m, n, seen = ray
    for i in range(3):
        v[i] = w[6, i] + column * w[2, i] + row * w[3, i]
    cross(u, v, m)
    apply(s, m, n)
    x, y = -w[7, 1] * dot(w[4], n), -w[7, 1] * dot(w[5], n)
    for i in range(3):
        seen[i] = v[i] + x * w[2, i] + y * w[3, i]
    vv = dot(v, v)
    return vv, dot(m, n) / vv


@njit(inline="always")
@no_type_check
def _part(z):
    """Part of a normal distribution between 0 and `z`."""
    return 0.5 * math.erf(z * ROOT_HALF)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def forward(which, gaussians, view, table, sampling, row_first, row_last, image):
    """Add some Gaussians to some rows of an image, without the factor |d|.

    Parameters
    ----------
    which : numbers of the Gaussians near an end of the rays
    gaussians : `recon.ops.arguments.GaussianArrays`
    view : `recon.ops.arguments.RayFrame`
    table : numbers of the footprints, which bound them, (gaussian, 13)
    sampling : `recon.ops.rasterize.projector.PixelSampling`
    row_first, row_last : rows from `row_first` to one before `row_last`
    image : added to, (basis, row, column and `WIDTH` columns of padding)
    """
    coefficients, columns = gaussians.coefficients, image.shape[2] - WIDTH
    k2 = sampling.cutoff * sampling.cutoff
    w = np.empty((SCRATCH, 3))
    ray = _vectors(w)
    u, seen = ray.u, ray.seen
    for g in which:
        p = table[g]
        if not project(gaussians.centres[g], gaussians.matrices[g], view, sampling.box, w):
            continue
        for row in range(max(int(p[ROW_1]), row_first), min(int(p[ROW_0]), row_last)):
            low, high = row_span(p, f4(row) - p[YC], f4(k2), columns)
            for column in range(low, high):
                vv, q = _cast(ray, float(column), float(row))
                if q >= k2:
                    continue
                length = math.sqrt(dot(seen, seen))
                z0 = dot(u, seen) / length
                value = w[7, 2] / math.sqrt(vv) * math.exp(-0.5 * q) * (_part(length - z0) + _part(z0))
                for m in range(coefficients.shape[1]):
                    image[m, row, column] += f4(value * coefficients[g, m])


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def backward(gaussians, g, view, p, cotangent, sampling, gradients):
    """Add the gradients of one Gaussian in one view.

    Parameters
    ----------
    gaussians : `recon.ops.arguments.GaussianArrays`
    g : number of the Gaussian
    view : `recon.ops.arguments.RayFrame`
    p : numbers of the footprint, which bound it, (13,)
    cotangent : gradient in the image, multiplied by |d|, (basis, row, column and `WIDTH` columns of padding)
    sampling : `recon.ops.rasterize.projector.PixelSampling`
    gradients : added to, `recon.ops.arguments.GaussianGradients`
    """
    coefficients, to_coefficients = gaussians.coefficients[g], gradients.coefficients[g]
    k2, columns = sampling.cutoff * sampling.cutoff, cotangent.shape[2] - WIDTH
    w, t = np.empty((SCRATCH, 3)), np.zeros((12, 3))  # t: u, vx, vy, A d0, S (3 rows), a, b, and three to work with
    if not project(gaussians.centres[g], gaussians.matrices[g], view, sampling.box, w):
        return
    ray = _vectors(w)
    bases, mass, to_c = len(coefficients), 0.0, 0.0
    _, u, s, v, m, n, seen = ray
    to_seen, to_m, to_n, c = t[9], t[10], t[11], w[7, 1]
    for row in range(int(p[ROW_1]), int(p[ROW_0])):
        low, high = row_span(p, f4(row) - p[YC], f4(k2), columns)
        for column in range(low, high):
            vv, q = _cast(ray, float(column), float(row))
            if q >= k2:
                continue
            length = math.sqrt(dot(seen, seen))
            z0 = dot(u, seen) / length
            z1 = length - z0
            whole, to_value = w[7, 2] / math.sqrt(vv) * math.exp(-0.5 * q), 0.0
            value = whole * (_part(z1) + _part(z0))
            for k in range(bases):
                incoming = float(cotangent[k, row, column])
                to_value += incoming * coefficients[k]
                to_coefficients[k] += incoming * value
            value *= to_value
            mass += value
            whole *= to_value / math.sqrt(2 * math.pi)
            to_z1 = whole * math.exp(-0.5 * z1 * z1)
            to_z0 = whole * math.exp(-0.5 * z0 * z0) - to_z1
            to_length = to_z1 - to_z0 * z0 / length
            for i in range(3):
                to_seen[i] = (to_z0 * u[i] + to_length * seen[i]) / length
            to_x, to_y = -c * dot(to_seen, w[2]), -c * dot(to_seen, w[3])
            along_x, along_y = dot(w[4], n), dot(w[5], n)
            to_c -= dot(to_seen, w[2]) * along_x + dot(to_seen, w[3]) * along_y
            for i in range(3):
                to_n[i] = to_x * w[4, i] + to_y * w[5, i]
                t[7, i] += to_x * n[i]
                t[8, i] += to_y * n[i]
            apply(s, to_n, to_m)
            for i in range(3):
                to_m[i] -= value / vv * n[i]
                for j in range(3):
                    t[4 + i, j] += 0.5 * (to_n[i] * m[j] + m[i] * to_n[j] - value / vv * m[i] * m[j])
            to_vv = value * (q - 1) / vv
            cross(v, to_m, m)
            cross(to_m, u, n)
            for i in range(3):
                t[0, i] += m[i] + to_z0 * seen[i] / length
                to_v = n[i] + to_seen[i] + to_vv * v[i]
                t[1, i] += column * to_v - c * along_x * to_seen[i]
                t[2, i] += row * to_v - c * along_y * to_seen[i]
                t[3, i] += to_v
    sums = _Sums(t, mass, to_c)
    _backpropagate(w, sums, sampling.box, gaussians.matrices[g], view, gradients.centres[g], gradients.matrices[g])


@njit(inline="always")
@no_type_check
def _backpropagate(w, sums, box, matrix, view, to_centre, to_matrix):
    """Compute gradients in centre and whitening matrix from sums over pixels: `project` in reverse."""
    t, mass, to_c, frame, inverse = sums.vectors, sums.mass, sums.to_c, view.frame, view.inverse
    depth, c, s, to_h = w[7, 0], w[7, 1], w[8:11], np.empty((3, 3))
    for i in range(3):
        for j in range(3):  # S = H^-1 and the amplitude det H^-1/2
            to_h[i, j] = -0.5 * mass * s[i, j]
            for k in range(3):
                for n in range(3):
                    to_h[i, j] -= s[i, k] * t[4 + k, n] * s[n, j]
    to_a, to_b = t[7], t[8]
    for i in range(3):
        for j in range(3):
            to_a[i] += 2 * c * to_h[i, j] * w[4, j]
            to_b[i] += 2 * c * to_h[i, j] * w[5, j]
            to_c += to_h[i, j] * (w[4, i] * w[4, j] + w[5, i] * w[5, j])
    square = max(dot(w[1], w[1]), TINY)
    to_depth, to_square = to_c * 2 * box * depth / square, -to_c * c / square
    x = w[12]
    if mass != 0 and (w[13, 1] != 0 or w[13, 2] != 0 or w[14, 0] != 0 or w[14, 2] != 0):
        # narrow covariance C = square / depth^2 (J^T J)^-1, so that J^T J gets -depth^2 / square C G C
        per = -mass / w[13, 0]
        g11, g12, g22 = per * w[14, 0], per * w[14, 1], per * w[14, 2]
        along = g11 * x[0] + 2 * g12 * x[1] + g22 * x[2]
        to_square += along / square
        to_depth -= 2 * along / depth
        scale = -depth * depth / square
        n11 = scale * (x[0] * x[0] * g11 + 2 * x[0] * x[1] * g12 + x[1] * x[1] * g22)
        n12 = scale * (x[0] * x[1] * g11 + (x[0] * x[2] + x[1] * x[1]) * g12 + x[1] * x[2] * g22)
        n22 = scale * (x[1] * x[1] * g11 + 2 * x[1] * x[2] * g12 + x[2] * x[2] * g22)
        for i in range(3):
            to_a[i] += 2 * (n11 * w[4, i] + n12 * w[5, i])
            to_b[i] += 2 * (n12 * w[4, i] + n22 * w[5, i])
        to_x, to_y = per * w[13, 1], per * w[13, 2]
        to_depth -= (w[11, 0] * to_x + w[11, 1] * to_y) / depth
        for j in range(3):
            to_centre[j] += (to_x * inverse[0, j] + to_y * inverse[1, j]) / depth
    cross(w[2], to_a, t[9])
    cross(w[3], to_b, t[10])
    for i in range(3):
        t[0, i] += t[9, i] + t[10, i] + 2 * to_square * w[1, i]
    cross(to_a, w[1], t[9])
    cross(to_b, w[1], t[10])
    for j in range(3):
        to_centre[j] += to_depth * inverse[2, j]
        for i in range(3):
            to_centre[j] += matrix[i, j] * t[0, i]
            to_matrix[i, j] += t[0, i] * w[0, j] + t[3, i] * frame[1, j]
            to_matrix[i, j] += (t[1, i] + t[9, i]) * frame[2, j] + (t[2, i] + t[10, i]) * frame[3, j]
