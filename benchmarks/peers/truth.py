"""What `peers.py` holds all programs to: line integrals in float64, written as their formulas and with no code of ours.

Chords of balls and cylinders come from the distance form of the discriminant, 1 - d^2 with the distance d from the axis
or the centre to the ray in local coordinates; crossings of triangles from Moeller & Trumbore 1997
(doi:10.1080/10867651.1997.10487468); paths through voxels from Siddon 1985 (doi:10.1118/1.595715). A later object owns
what it covers.
"""

from dataclasses import replace
from math import floor, sqrt

import numpy as np
from numba import njit, prange

from benchmarks.peers.scenes import BALL, Case


def rays_of(frame: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Vectors from the source to pixels (row, column)."""
    return frame[1] + pixels[:, 1:] * frame[2] + pixels[:, :1] * frame[3]


def truth(case: Case, frame: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Line integral of the ray to each of some pixels (row, column); nan where it crosses a mesh oddly often."""
    if case.mean_of > 1:
        places, centre = (np.arange(case.mean_of) + 0.5) / case.mean_of - 0.5, replace(case, mean_of=1)
        shifts = [
            [0 * frame[1], u * frame[2] + v * frame[3], 0 * frame[1], 0 * frame[1]] for u in places for v in places
        ]
        return sum(truth(centre, frame + shift, pixels) for shift in shifts) / len(shifts)
    rays = rays_of(frame, pixels)
    norms = np.linalg.norm(rays, axis=1)
    if case.volume is not None:
        origin = -(np.array(case.volume.shape[::-1]) - 1) / 2 * case.spacing
        start, ways = (frame[0] - origin) / case.spacing, rays / case.spacing
        return siddon(case.volume, start[::-1].copy(), np.ascontiguousarray(ways[:, ::-1])) * norms
    if case.meshes:
        corners = np.concatenate([mesh.vertices[mesh.triangles] for mesh in case.meshes])
        first = np.cumsum([0, *(len(mesh.triangles) for mesh in case.meshes)])
        return meshes(corners, first, np.array([mesh.mu for mesh in case.meshes]), frame[0], rays) * norms
    kinds = np.array([s.kind for s in case.solids])
    centers = np.stack([s.center for s in case.solids])
    inverses = np.linalg.inv(np.stack([s.axes for s in case.solids]))
    return solids(kinds, centers, inverses, np.array([s.mu for s in case.solids]), frame[0], rays) * norms


@njit(cache=True, inline="always")
def chord(kind, start, way, low_high):
    """Write where a ray, in local coordinates, is inside of the unit ball or cylinder; 0 <= t <= 1."""
    axes = 3 if kind == BALL else 2
    square = along = 0.0
    for i in range(axes):
        square, along = square + way[i] * way[i], along + start[i] * way[i]
    middle = -along / square if square > 0 else 0.0
    rest = 1.0
    for i in range(axes):
        rest -= (start[i] + middle * way[i]) ** 2
    low, high = 0.0, 0.0 if rest <= 0 else 1.0
    if rest > 0 and square > 0:
        low, high = max(low, middle - sqrt(rest / square)), min(high, middle + sqrt(rest / square))
    if kind != BALL:
        if way[2] == 0:
            high = high if abs(start[2]) < 1 else -1.0
        else:
            one, other = (-1 - start[2]) / way[2], (1 - start[2]) / way[2]
            low, high = max(low, min(one, other)), min(high, max(one, other))
    low_high[0], low_high[1] = low, high


@njit(cache=True)
def painted(pieces, mus):
    """Sum of mu over 0 <= t <= 1, where piece (low, high, object) of the highest object counts."""
    bounds, total = np.sort(pieces[:, :2].copy().reshape(-1)), 0.0
    for i in range(bounds.size - 1):
        width, owner = bounds[i + 1] - bounds[i], -1.0
        if width > 0:
            for j in range(len(pieces)):
                if pieces[j, 0] <= bounds[i] and pieces[j, 1] >= bounds[i + 1]:
                    owner = max(owner, pieces[j, 2])
            if owner >= 0:
                total += width * mus[int(owner)]
    return total


@njit(cache=True, parallel=True, error_model="numpy")
def solids(kinds, centers, inverses, mus, source, rays):
    """Line integrals through solids, per unit of t."""
    out = np.empty(len(rays))
    for ray in prange(len(rays)):
        pieces, count, ends = np.empty((len(kinds), 3)), 0, np.empty(2)
        start, way = np.empty(3), np.empty(3)
        for s in range(len(kinds)):
            for i in range(3):
                start[i] = way[i] = 0.0
                for j in range(3):
                    start[i] += inverses[s, i, j] * (source[j] - centers[s, j])
                    way[i] += inverses[s, i, j] * rays[ray, j]
            chord(kinds[s], start, way, ends)
            if ends[1] > ends[0]:
                pieces[count, 0], pieces[count, 1], pieces[count, 2] = ends[0], ends[1], s
                count += 1
        out[ray] = painted(pieces[:count], mus)
    return out


@njit(cache=True, error_model="numpy")
def crossings(source, way, corners):
    """Where a ray's line crosses triangles (triangle, corner, 3), ascending."""
    found, count = np.empty(len(corners)), 0
    for k in range(len(corners)):
        a, b, s = corners[k, 1] - corners[k, 0], corners[k, 2] - corners[k, 0], source - corners[k, 0]
        p0, p1, p2 = way[1] * b[2] - way[2] * b[1], way[2] * b[0] - way[0] * b[2], way[0] * b[1] - way[1] * b[0]
        det = a[0] * p0 + a[1] * p1 + a[2] * p2
        if det == 0.0:
            continue
        u = (s[0] * p0 + s[1] * p1 + s[2] * p2) / det
        if not 0.0 <= u <= 1.0:
            continue
        q0, q1, q2 = s[1] * a[2] - s[2] * a[1], s[2] * a[0] - s[0] * a[2], s[0] * a[1] - s[1] * a[0]
        v = (way[0] * q0 + way[1] * q1 + way[2] * q2) / det
        if v >= 0.0 and u + v <= 1.0:
            found[count] = (b[0] * q0 + b[1] * q1 + b[2] * q2) / det
            count += 1
    return np.sort(found[:count])


@njit(cache=True, parallel=True, error_model="numpy")
def meshes(corners, first, mus, source, rays):
    """Line integrals through closed meshes, of which m owns the triangles ``first[m]`` to ``first[m + 1]``."""
    out = np.empty(len(rays))
    for ray in prange(len(rays)):
        pieces, count = np.empty((64, 3)), 0
        for m in range(len(mus)):
            places = crossings(source, rays[ray], corners[first[m] : first[m + 1]])
            if len(places) % 2:
                count = -1
                break
            for i in range(len(places) // 2):
                low, high = max(0.0, places[2 * i]), min(1.0, places[2 * i + 1])
                if high > low:
                    pieces[count, 0], pieces[count, 1], pieces[count, 2] = low, high, m
                    count += 1
        out[ray] = painted(pieces[:count], mus) if count >= 0 else np.nan
    return out


@njit(cache=True, parallel=True, error_model="numpy")
def siddon(volume, start, ways):
    """Path through voxels (z, y, x) of constant value, per unit of t."""
    out = np.empty(len(ways))
    for ray in prange(len(ways)):
        way, t, end, total = ways[ray], 0.0, 1.0, 0.0
        shape, index, ahead = np.array(volume.shape), np.zeros(3, np.int64), np.full(3, np.inf)
        for i in range(3):
            if way[i] == 0.0:
                end = end if -0.5 <= start[i] < shape[i] - 0.5 else -1.0
            else:
                one, other = (-0.5 - start[i]) / way[i], (shape[i] - 0.5 - start[i]) / way[i]
                t, end = max(t, min(one, other)), min(end, max(one, other))
        for i in range(3):
            index[i] = min(shape[i] - 1, max(0, floor(start[i] + t * way[i] + 0.5)))
            if way[i] != 0:
                ahead[i] = (index[i] + (0.5 if way[i] > 0 else -0.5) - start[i]) / way[i]
        while t < end:
            i = ahead.argmin()
            past = min(ahead[i], end)
            total += max(0.0, past - t) * volume[index[0], index[1], index[2]]
            t = max(t, past)
            index[i] += 1 if way[i] > 0 else -1
            if not 0 <= index[i] < shape[i]:
                break
            ahead[i] = (index[i] + (0.5 if way[i] > 0 else -0.5) - start[i]) / way[i]
        out[ray] = total
    return out
