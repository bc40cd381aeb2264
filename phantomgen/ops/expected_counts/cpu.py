"""Pixel averages of expected counts in numba, one view at a time.

Every pixel gets the cheapest rule that is good enough there; `phantomgen.ops.expected_counts.pixel_classes` lists them.
"""

from typing import no_type_check

import numpy as np
from numba import njit

from phantomgen.ops.expected_counts.pixel_classes import CROSSED, EMPTY, INTERSECTED, NEAR, SMOOTH, VOXELS
from phantomgen.ops.expected_counts.rectangles import RayList, begin_pixel, estimate, halve, measure, worst_of
from phantomgen.ops.kernel_decorators import called, inlined
from phantomgen.ops.mesh.cpu import list_pieces
from phantomgen.ops.silhouette.quadrature import CONICS, grid_nodes, lattice_nodes, may_vanish, shift_form, square_nodes
from phantomgen.ops.silhouette.tiles_cpu import list_active, touches
from phantomgen.ops.trace.cpu import ORDER, add_pieces, owned_pieces
from phantomgen.ops.trace.table import set_origin
from spectra.ops.transmit.cpu import expected_ray

# Ratios of counts in neighbouring pixels, no unit: above each of them, the next stronger rule is used; differences over
# neighbours are used below the first one only. Accuracy in `phantomgen.ops.expected_counts`.
_CONTRASTS = (1.4, 2.2, 5.0, 25.0)
# Second difference of the open beam's logarithm, no unit: a tenth of it at most is beam hardening, and of that 1/24 is
# an error, 4e-6 of log counts.
_BEND = 1e-3
# Counts are taken to be at least this part of those without objects, no unit; smaller ones have no relative error.
_LEAST = 1e-30


@inlined
@no_type_check
def _pixel_range(low, high, count):
    """Indices of pixels that the range low .. high touches, as a half-open range."""
    return int(max(0.0, min(count, np.floor(low + 0.5)))), int(max(0.0, min(count, np.ceil(high + 0.5))))


@inlined
@no_type_check
def _is_near(local, i, root, reach):
    """Whether the pixel's centre lies inside a tangent conic and closer to it than `reach` (to first order)."""
    slopes = local[i, 1] * local[i, 1] + local[i, 2] * local[i, 2]
    return root > 0.0 and local[i, 0] > 0.0 and local[i, 0] * local[i, 0] < reach * reach * slopes


@inlined
@no_type_check
def _narrow(local, i, aperture):
    """Take the unit square of a local form for the sensitive part of a pixel, of some width and height."""
    width, height = aperture
    local[i, 1] *= width
    local[i, 2] *= height
    local[i, 3] *= width * width
    local[i, 4] *= width * height
    local[i, 5] *= height * height


@inlined
@no_type_check
def _narrow_nodes(nodes, first, last, aperture):
    """Draw nodes of the unit square together, to the sensitive part of a pixel."""
    width, height = aperture
    if width != 1.0 or height != 1.0:
        for i in range(first, last):
            nodes[i, 0] *= width
            nodes[i, 1] *= height


@called
@no_type_check
def _send_rays(view, mesh, profile, rays, count, first, one, target):
    """Write the average counts of pixels, or of parts of them.

    Parameters
    ----------
    view : `View`
    mesh, profile : of the view; arguments of their own, as numba leaves out a branch for None only where an argument
        is None
    rays, count, first : `RayList`, number of its jobs, and index of the first node
    one : `RayCounts`
    target : counts (channel, place, place), written
    """
    frame, solids, _, tiles, beam = view
    table, tubes, maps, background = solids
    attenuation, weights, starts, air, _ = beam
    jobs, nodes, seen = rays
    scratch, lengths, counts = one
    active, events = scratch
    shapes = np.int64(0)
    for job in range(count):
        row, column, last, at, place = jobs[job, 0], jobs[job, 1], jobs[job, 2], jobs[job, 3], jobs[job, 4]
        if job == 0 or row != jobs[job - 1, 0] or column != jobs[job - 1, 1]:
            shapes = list_active(tiles, row, column, active)
        for c in range(counts.size):
            target[c, at, place] = 0.0
        for i in range(first, last):
            u, v, weight = column + nodes[i, 0], row + nodes[i, 1], nodes[i, 2]
            dx = frame[1, 0] + u * frame[2, 0] + v * frame[3, 0]
            dy = frame[1, 1] + u * frame[2, 1] + v * frame[3, 1]
            dz = frame[1, 2] + u * frame[2, 2] + v * frame[3, 2]
            direction = (dx, dy, dz)
            if mesh is None:
                pieces = owned_pieces(table, tubes, None, direction, active, shapes, events)
            else:
                list_pieces(mesh, row * air.shape[2] + column, u, v)
                pieces = owned_pieces(table, tubes, mesh.pieces, direction, active, shapes, events)
            signature = add_pieces(table, maps, background, direction, pieces, events, lengths)
            if profile is None and signature == 0 and background < 0:
                for c in range(counts.size):
                    target[c, at, place] += weight * air[c, row, column]
            else:
                if profile is not None:
                    for p in range(profile.shape[0]):
                        lengths[lengths.size - profile.shape[0] + p] = profile[p, row, column]
                expected_ray(lengths, attenuation, weights, starts, counts)
                for c in range(counts.size):
                    target[c, at, place] += weight * counts[c]
            seen[i] = signature
        first = last


@called
@no_type_check
def _adapt(view, rules, one, rectangles, pixel, target):
    """Write the average counts of one pixel, halved into rectangles until their errors sum to less than the tolerance.

    Errors are those of the worst channel, relative to its counts. Returns the number of rays.

    Parameters
    ----------
    view, rules : `View` and `PixelRules`
    one, rectangles : `RayCounts` and `RectangleScratch`
    pixel : row and column
    target : counts (channel, row, column), written
    """
    table, counts, averages, rays = rectangles
    air, (row, column) = view.beam.air, pixel
    begin = worst = sent = np.int64(0)
    known = np.int64(1)
    asked = begin_pixel(table, pixel, rays)
    _narrow_nodes(rays.nodes, begin, asked, rules.aperture)
    for c in range(air.shape[0]):
        target[c, row, column] = averages[c, 0] = 0.0
    while True:
        _send_rays(view, view.mesh, view.beam.profile, rays, asked, begin, one, counts)
        sent += asked
        for i in range(2 if known > 1 else 1):
            at = known - 1 if i else worst
            measure(table, counts, averages, at)
            for c in range(air.shape[0]):
                target[c, row, column] += averages[c, at]
        for i in range(2 if known > 1 else 1):
            estimate(table, counts, target, air, _LEAST, pixel, known - 1 if i else worst)
        worst, total = worst_of(table, known)
        if total <= rules.tolerance or known == table.shape[0]:
            return sent
        for c in range(air.shape[0]):
            target[c, row, column] -= averages[c, worst]
        asked = halve(table, counts, worst, known, pixel, rays)
        _narrow_nodes(rays.nodes, begin, asked, rules.aperture)
        known += 1


@inlined
@no_type_check
def _is_intersected(nodes, seen, first, last):
    """Whether rays without a silhouette between them meet the same in another order: surfaces intersect there."""
    for i in range(first + 1, last):
        j = i - 1  # most often the one before lies in the same part
        while j >= first and nodes[j, 3] != nodes[i, 3]:
            j -= 1
        if j >= first and seen[j] != seen[i] and (seen[j] ^ seen[i]) & ~ORDER == 0:
            return True
    return False


@called
@no_type_check
def _settle(view, outline, rules, scratch, filled, pixel, target):
    """Correct the counts of one pixel that silhouettes cross and where surfaces intersect; return the number of rays.

    The strongest Gauss rule is enough if it changes little; else the pixel is cut into rectangles. Parameters are those
    of `_adapt` and of `expected_counts_of_view`; nodes from index `filled` on are free.
    """
    one, room, rays, rectangles, _, _, _ = scratch
    local, lines, nodes = room
    gauss, counts = rules.gauss, rectangles.counts
    (row, column), single, sent = pixel, np.int64(1), np.int64(0)
    conics = _gather(outline, view.tiles, rules, row, column, one.ray.active, local)
    if conics <= CONICS:
        strongest = gauss.nodes.shape[0] - 1
        last = square_nodes(local, conics, gauss.nodes[strongest], gauss.sizes[strongest], lines, nodes, filled)
        _narrow_nodes(nodes, filled, last, rules.aperture)
        sent = last - filled
        jobs = rectangles.rays.jobs
        jobs[0, 0], jobs[0, 1], jobs[0, 2], jobs[0, 3], jobs[0, 4] = row, column, last, 0, 0
        more = RayList(jobs, nodes, rays.seen)
        _send_rays(view, view.mesh, view.beam.profile, more, single, filled, one, counts)
        change = 0.0
        for c in range(target.shape[0]):
            low = max(counts[c, 0, 0], _LEAST * view.beam.air[c, row, column])
            change = max(change, abs(counts[c, 0, 0] - target[c, row, column]) / low)
            target[c, row, column] = counts[c, 0, 0]
        if change <= rules.tolerance:
            return sent
    return sent + _adapt(view, rules, one, rectangles, pixel, target)


@called
@no_type_check
def _flush(view, outline, rules, scratch, count, completing, target, out):
    """Send the rays of pixels; then keep the signatures of centres, or look for intersections between silhouettes.

    Parameters are those of `_send_rays` and of `expected_counts_of_view`.
    """
    jobs, nodes, seen = scratch.rays
    signatures, classes, rays = scratch.signatures, out.classes, out.rays
    first = np.int64(0)
    _send_rays(view, view.mesh, view.beam.profile, scratch.rays, count, first, scratch.one, target)
    filled = jobs[count - 1, 2] if count > 0 else first
    for job in range(count):
        row, column, last = jobs[job, 0], jobs[job, 1], jobs[job, 2]
        kind = classes[row, column]
        if not completing:
            signatures[row, column] = seen[last - 1]
        elif rules.tolerance > 0.0 and kind in (CROSSED, NEAR) and _is_intersected(nodes, seen, first, last):
            rays[kind] += _settle(view, outline, rules, scratch, filled, (row, column), target)
        first = last


@inlined
@no_type_check
def _fill_open_beam(profile, beam, one):
    """Write the counts of a ray to each pixel that meets no object, where there is a profile."""
    if profile is not None:
        attenuation, weights, starts, air, _ = beam
        _, lengths, counts = one
        for m in range(lengths.size):
            lengths[m] = 0.0
        for row in range(air.shape[1]):
            for column in range(air.shape[2]):
                for p in range(profile.shape[0]):
                    lengths[lengths.size - profile.shape[0] + p] = profile[p, row, column]
                expected_ray(lengths, attenuation, weights, starts, counts)
                for c in range(counts.size):
                    air[c, row, column] = counts[c]


@inlined
@no_type_check
def _classify(outline, background, rules, local, classes):
    """Raise the class of each pixel as far as bounds and silhouettes decide it."""
    forms, shapes, roots, bounds, _, _ = outline
    reach, aperture = rules.reach, rules.aperture
    rows, columns = classes.shape
    if background >= 0:
        for row in range(rows):
            for column in range(columns):
                classes[row, column] = SMOOTH
    for s in range(bounds.shape[0]):
        first, last = _pixel_range(bounds[s, 0], bounds[s, 1], columns)
        top, bottom = _pixel_range(bounds[s, 2], bounds[s, 3], rows)
        for row in range(top, bottom):
            for column in range(first, last):
                classes[row, column] = max(classes[row, column], SMOOTH)
    row_0 = np.int64(0)
    for f in range(shapes.size):
        s = shapes[f]
        first, last = _pixel_range(bounds[s, 0], bounds[s, 1], columns)
        top, bottom = _pixel_range(bounds[s, 2], bounds[s, 3], rows)
        for row in range(top, bottom):
            for column in range(first, last):
                if classes[row, column] == CROSSED:
                    continue
                shift_form(forms, f, float(column), float(row), local, row_0)
                _narrow(local, row_0, aperture)
                if may_vanish(local, row_0):
                    classes[row, column] = CROSSED
                elif _is_near(local, row_0, roots[f], reach):
                    classes[row, column] = NEAR


@inlined
@no_type_check
def _mark_creases(creases, classes):
    """Class of the pixels that a silhouette or a crease of a mesh passes."""
    for row in range(classes.shape[0]):
        for column in range(classes.shape[1]):
            if creases[row, column]:
                classes[row, column] = INTERSECTED


@inlined
@no_type_check
def _add_ring(rings, f, aperture, local, i):
    """Write a silhouette of a torus as a conic of the pixel it belongs to."""
    for k in range(6):
        local[i, k] = rings.forms[f, k]
    local[i, 6], local[i, 7] = 0.0, 1.0
    _narrow(local, i, aperture)


@inlined
@no_type_check
def _mark_rings(rings, rules, local, classes):
    """Raise the class of pixels that silhouettes of tori pass, or pass near."""
    columns, row_0 = classes.shape[1], np.int64(0)
    for row in range(classes.shape[0]):
        for column in range(columns):
            cell = row * columns + column
            for f in range(rings.starts[cell], rings.starts[cell + 1]):
                _add_ring(rings, f, rules.aperture, local, row_0)
                if may_vanish(local, row_0):
                    classes[row, column] = max(classes[row, column], CROSSED)
                elif _is_near(local, row_0, 1.0, rules.reach):
                    classes[row, column] = max(classes[row, column], NEAR)
            if rings.creased[row, column]:
                classes[row, column] = INTERSECTED


@inlined
@no_type_check
def _mark_maps(numbers, bounds, classes):
    """Class of the pixels that a voxel map projects to, where no stronger rule is needed anyway."""
    for s in range(numbers.size):
        if numbers[s] >= 0:
            first, last = _pixel_range(bounds[s, 0], bounds[s, 1], classes.shape[1])
            top, bottom = _pixel_range(bounds[s, 2], bounds[s, 3], classes.shape[0])
            for row in range(top, bottom):
                for column in range(first, last):
                    if classes[row, column] < CROSSED:
                        classes[row, column] = VOXELS


@inlined
@no_type_check
def _mark(rings, creases, maps, bounds, rules, local, classes):
    """Raise the class of pixels because of tori, meshes and voxel maps."""
    if rings is not None:
        _mark_rings(rings, rules, local, classes)
    if creases is not None:
        _mark_creases(creases, classes)
    if maps is not None:
        _mark_maps(maps.numbers, bounds, classes)


@inlined
@no_type_check
def _map_nodes(maps, nodes, begun, count):
    """Write the nodes of a pixel that a voxel map projects to; no code is compiled without maps."""
    return begun if maps is None else lattice_nodes(nodes, begun, count)


@inlined
@no_type_check
def _crossed_level(level, conics, strongest, maps, bounds, u, v):
    """Level of Gauss rules in a pixel (u, v) that silhouettes cross: the strongest where there are voxels, too."""
    level = max(level, min(conics, 2))
    if maps is not None:
        for s in range(maps.numbers.size):
            if maps.numbers[s] >= 0 and touches(bounds, s, u, v):
                level = strongest
    return level


@inlined
@no_type_check
def _gather_rings(rings, rules, row, column, local):
    """Collect silhouettes of tori of a pixel; return how many."""
    found = np.int64(0)
    if rings is not None:
        cell = row * rings.creased.shape[1] + column
        for f in range(rings.starts[cell], rings.starts[cell + 1]):
            _add_ring(rings, f, rules.aperture, local, found)
            if may_vanish(local, found) or _is_near(local, found, 1.0, rules.reach):
                found += 1
                if found > CONICS:
                    return found
    return found


@inlined
@no_type_check
def _gather(outline, tiles, rules, row, column, active, local):
    """Collect the conics that cross a pixel, and the tangents that pass near it; return how many."""
    forms, roots, reach, aperture = outline.forms, outline.roots, rules.reach, rules.aperture
    firsts, u, v = tiles.firsts, float(column), float(row)
    found = _gather_rings(outline.rings, rules, row, column, local)
    if found > CONICS:
        return found
    for i in range(list_active(tiles, row, column, active)):
        for f in range(firsts[active[i]], firsts[active[i] + 1]):
            shift_form(forms, f, u, v, local, found)
            _narrow(local, found, aperture)
            if may_vanish(local, found) or _is_near(local, found, roots[f], reach):
                local[found, 7] = roots[f]
                found += 1
                if found > CONICS:
                    return found
    return found


@inlined
@no_type_check
def _settled(classes, signatures, level, row, column):
    """Class of a pixel in the light of the rays through its and its neighbours' centres.

    A pixel one of whose eight neighbours, not crossed either, passes surfaces in another order is INTERSECTED; a smooth
    one is NEAR if it lacks a neighbour to take differences with, or if its contrast is high.
    """
    rows, columns = classes.shape
    kind = classes[row, column]
    if kind in (EMPTY, CROSSED, INTERSECTED, VOXELS):
        return kind
    if level > 0:
        kind = NEAR
    for i in range(9):
        r, c = row + i // 3 - 1, column + i % 3 - 1
        if not (0 <= r < rows and 0 <= c < columns) or classes[r, c] in (CROSSED, VOXELS):
            if i % 2:  # the four that share a side, which differences are taken with
                kind = max(kind, NEAR)
        elif (signatures[r, c] ^ signatures[row, column]) & ORDER:
            return INTERSECTED
    return kind


@inlined
@no_type_check
def _contrast_level(centres, air, row, column):
    """How many of the limits `_CONTRASTS` the counts of a pixel and its neighbours exceed in the worst channel."""
    level = np.int64(0)
    for channel in range(air.shape[0]):
        low = high = centres[channel, row, column]
        for i in range(4):
            r, c = row + (i == 0) - (i == 1), column + (i == 2) - (i == 3)
            if 0 <= r < centres.shape[1] and 0 <= c < centres.shape[2]:
                low, high = min(low, centres[channel, r, c]), max(high, centres[channel, r, c])
        low = max(low, 1e-30 * air[channel, row, column])
        while level < 4 and high > low * _CONTRASTS[level]:
            level += 1
    return level


@inlined
@no_type_check
def _bend_level(profile, air, row, column):
    """1 where the open beam bends so much that neighbours do not tell about a pixel, as at a bowtie's knots; else 0."""
    level = np.int64(0)
    if profile is not None:
        for channel in range(air.shape[0]):
            limit = _BEND * air[channel, row, column] ** 2
            for i in range(2):
                r, c = i, 1 - i
                if 0 < row < air.shape[1] - 1 and 0 < column < air.shape[2] - 1:
                    around = air[channel, row - r, column - c] * air[channel, row + r, column + c]
                    if abs(around - air[channel, row, column] ** 2) > limit:
                        level = np.int64(1)
    return level


@inlined
@no_type_check
def _curved(centres, air, profile, aperture, channel, row, column):
    """Average over a pixel of a function that is smooth over its four neighbours, known at their centres.

    Midpoint value plus 1/24 of the second differences, times the square of the sensitive width or height: exact for
    cubic polynomials. Where the open beam changes from pixel to pixel, neighbours count relative to theirs.
    """
    across, down = aperture[0] * aperture[0], aperture[1] * aperture[1]
    middle = centres[channel, row, column]
    if profile is None:
        around = down * (centres[channel, row - 1, column] + centres[channel, row + 1, column])
        around += across * (centres[channel, row, column - 1] + centres[channel, row, column + 1])
    else:
        if middle == 0.0:
            return middle
        around = 0.0
        for i in range(4):
            r, c = row + (i == 0) - (i == 1), column + (i == 2) - (i == 3)
            share = down if i < 2 else across
            around += share * (centres[channel, r, c] / air[channel, r, c] * air[channel, row, column])
    return middle + (around - 2.0 * (across + down) * middle) / 24.0


@inlined
@no_type_check
def _average_of_centres(centres, air, profile, aperture, kind, row, column, target):
    """Write the counts of an empty or smooth pixel, which needs no rays but those through centres."""
    for c in range(air.shape[0]):
        smooth = kind == SMOOTH
        if smooth:
            target[c, row, column] = _curved(centres, air, profile, aperture, c, row, column)
        else:
            target[c, row, column] = air[c, row, column]


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def expected_counts_of_view(view, outline, rules, scratch, out):  # noqa: PLR0912 - the choice of a rule per pixel
    """Average expected counts over all pixels of one view.

    Parameters
    ----------
    view : `View`
    outline : `Outline`
    rules : `PixelRules`
    scratch : `ViewScratch`
    out : `ExpectedCounts`: counts and classes are written, numbers of rays are added to
    """
    frame, solids, _, tiles, beam = view
    one, room, rays, rectangles, centres, guess, signatures = scratch
    local, lines, nodes = room
    table, jobs, active = solids.table, rays.jobs, one.ray.active
    gauss, aperture, sub_rays = rules.gauss, rules.aperture, rules.sub_rays
    air, classes = beam.air, out.classes
    _fill_open_beam(beam.profile, beam, one)
    rows, columns = classes.shape
    for s in range(table.shape[0]):
        set_origin(table, s, frame[0, 0], frame[0, 1], frame[0, 2])
    _classify(outline, solids.background, rules, local, guess)
    _mark(outline.rings, outline.creases, solids.maps, tiles.bounds, rules, local, guess)
    # The first round sends rays through centres, the second one completes the pixels that need more.
    for completing in range(1 if sub_rays == 1 else 2):
        target = out.counts if completing or sub_rays == 1 else centres
        count = filled = np.int64(0)
        for row in range(rows):
            for column in range(columns):
                kind = guess[row, column]
                if completing and kind != EMPTY:
                    level = _contrast_level(centres, air, row, column)
                    level = max(level, _bend_level(beam.profile, air, row, column))
                    kind = _settled(guess, signatures, level, row, column)
                classes[row, column] = kind
                if kind == EMPTY or (completing and kind == SMOOTH):
                    _average_of_centres(centres, air, beam.profile, aperture, kind, row, column, target)
                    continue
                begun = filled
                conics = np.int64(0)
                if completing and sub_rays == 0 and kind in (CROSSED, NEAR):
                    conics = _gather(outline, tiles, rules, row, column, active, local)
                if completing and sub_rays == 0 and (kind == INTERSECTED or conics > CONICS):
                    out.rays[kind] += _adapt(view, rules, one, rectangles, (row, column), out.counts)
                    continue
                if not completing or sub_rays > 0:
                    filled = grid_nodes(nodes, begun, sub_rays if completing else np.int64(1))
                elif kind == VOXELS:
                    filled = _map_nodes(solids.maps, nodes, begun, rules.map_rays)
                else:
                    if kind == CROSSED:
                        strongest = np.int64(gauss.nodes.shape[0] - 1)
                        u, v = float(column), float(row)
                        level = _crossed_level(level, conics, strongest, solids.maps, tiles.bounds, u, v)
                    filled = square_nodes(local, conics, gauss.nodes[level], gauss.sizes[level], lines, nodes, begun)
                _narrow_nodes(nodes, begun, filled, aperture)
                out.rays[kind] += filled - begun
                jobs[count, 0], jobs[count, 1], jobs[count, 2] = row, column, filled
                jobs[count, 3], jobs[count, 4] = row, column
                count += 1
                if filled > nodes.shape[0] // 3:
                    _flush(view, outline, rules, scratch, count, completing, target, out)
                    count = filled = np.int64(0)
        _flush(view, outline, rules, scratch, count, completing, target, out)


@njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def expected_counts_of_pixels(view, rays, pixels, one, out):
    """Average expected counts over the same nodes in each of some pixels.

    Parameters
    ----------
    view : `View`
    rays : `RayList` of one job, with the nodes
    pixels : row and column of each pixel (pixel, 2)
    one : `RayCounts`
    out : counts (channel, row, column); those of the pixels are written
    """
    job, nodes, _ = rays
    frame, table = view.frame, view.solids.table
    first, count = np.int64(0), np.int64(1)  # typed, as literals would compile `_send_rays` a second time
    for s in range(table.shape[0]):
        set_origin(table, s, frame[0, 0], frame[0, 1], frame[0, 2])
    for i in range(pixels.shape[0]):
        job[0, 0], job[0, 1], job[0, 2] = pixels[i, 0], pixels[i, 1], nodes.shape[0]
        job[0, 3], job[0, 4] = pixels[i, 0], pixels[i, 1]
        _send_rays(view, view.mesh, view.beam.profile, rays, count, first, one, out)
