"""Where a ray runs inside a torus.

Along a ray of unit direction, measured from the point nearest to the centre, the implicit quartic has no cubic term.
Its extrema bracket the roots; these are then sought on the distance from the ring, ``(h - R)^2 + z^2 - r^2``, which
does not cancel like the quartic does.
"""

from math import sqrt
from typing import no_type_check

from phantomgen.ops.kernel_decorators import called, inlined

# Relative room for rounding where a ray is found not to meet a torus, without solving for its ends.
_MARGIN = 1e-9
# Safeguarded Newton iterations; bisection alone would reach the rounding of a float64 (53 bits) with as many.
_STEPS = 60


@inlined
@no_type_check
def _depth(tube, x, y, z):
    """Square of the distance from the ring minus that of the tube's radius: negative inside."""
    h = sqrt(x * x + y * y) - (1.0 - tube)
    return h * h + (z - tube) * (z + tube)


@inlined
@no_type_check
def _extremum(p, q, low, high):
    """Zero of ``4 t^3 + 2 p t + q`` between `low` and `high`, where it changes sign."""
    rising = (4.0 * high * high + 2.0 * p) * high + q > 0.0
    t = 0.5 * (low + high)
    for _ in range(_STEPS):
        value = (4.0 * t * t + 2.0 * p) * t + q
        if (value > 0.0) == rising:
            high = t
        else:
            low = t
        slope = 12.0 * t * t + 2.0 * p
        step = t - value / slope if slope != 0.0 else low
        if not low < step < high:
            step = 0.5 * (low + high)
        if step == t:
            break
        t = step
    return t


@called
@no_type_check
def _surface(tube, point, direction, low, high):
    """Where the ray crosses the surface between `low` and `high`, of which one lies inside."""
    x, y, z = point
    dx, dy, dz = direction
    inside_first = _depth(tube, x + low * dx, y + low * dy, z + low * dz) < 0.0
    t = 0.5 * (low + high)
    for _ in range(_STEPS):
        px, py, pz = x + t * dx, y + t * dy, z + t * dz
        h = sqrt(px * px + py * py)
        value = (h - (1.0 - tube)) * (h - (1.0 - tube)) + (pz - tube) * (pz + tube)
        if (value < 0.0) == inside_first:
            low = t
        else:
            high = t
        slope = 2.0 * pz * dz
        if h > 0.0:
            slope += 2.0 * (h - (1.0 - tube)) * (px * dx + py * dy) / h
        step = t - value / slope if slope != 0.0 else low
        if not low < step < high:
            step = 0.5 * (low + high)
        if step == t or not low < step < high:
            break
        t = step
    return t


@inlined
@no_type_check
def _extrema(p, q, reach):
    """Extrema of ``t^4 + p t^2 + q t`` between -reach and reach, ascending; those missing are `reach`."""
    turn = sqrt(-p / 6.0) if p < 0.0 else 0.0  # the slope itself has its extrema at -turn and turn
    bends = (-reach, -min(turn, reach), min(turn, reach), reach)
    first = second = third = reach
    for i in range(3):
        low, high = bends[i], bends[i + 1]
        if low < high and ((4.0 * low * low + 2.0 * p) * low + q > 0.0) != (
            (4.0 * high * high + 2.0 * p) * high + q > 0.0
        ):
            first, second, third = second, third, _extremum(p, q, low, high)
    if third == reach:
        return first, second, third
    # Those found stand last: move the places that stayed empty behind them.
    if second == reach:
        return third, reach, reach
    if first == reach:
        return second, third, reach
    return first, second, third


@inlined
@no_type_check
def _misses(tube, origin, direction):
    """Whether the ray certainly does not meet the torus: above or below it, around it, or through its hole."""
    ox, oy, oz = origin
    dx, dy, dz = direction
    room = (1.0 + _MARGIN) * tube
    first, last = 0.0, 1.0
    if dz == 0.0:
        if abs(oz) > room:
            return True
    else:
        one, other = (-room - oz) / dz, (room - oz) / dz
        first, last = max(first, min(one, other)), min(last, max(one, other))
        if first > last:
            return True
    across = dx * dx + dy * dy
    nearest = min(max(-(ox * dx + oy * dy) / across, first), last) if across > 0.0 else first
    x, y = ox + nearest * dx, oy + nearest * dy
    if x * x + y * y > 1.0 + _MARGIN:
        return True
    hole = 1.0 - 2.0 * room
    if hole <= 0.0:
        return False
    x, y, u, v = ox + first * dx, oy + first * dy, ox + last * dx, oy + last * dy
    return max(x * x + y * y, u * u + v * v) < hole * hole


@called
@no_type_check
def torus_intervals(tube, origin, direction, row, hits, events):
    """Write the parts of ``0 <= t <= 1`` of a ray that lie inside a torus.

    Parameters
    ----------
    tube : radius of the tube in local coordinates, where the ring and its tube reach the radius 1
    origin, direction : start of the ray, and the vector from there to its end, in local coordinates
    row, hits : row of the primitive; number of hits that are listed before
    events : scratch of `phantomgen.ops.trace.cpu`, where hits are added

    Returns
    -------
    number of parts, at most 2
    """
    if _misses(tube, origin, direction):
        return 0
    ox, oy, oz = origin
    dx, dy, dz = direction
    length = sqrt(dx * dx + dy * dy + dz * dz)
    if length == 0.0:
        return 0
    dx, dy, dz = dx / length, dy / length, dz / length
    nearest = -(ox * dx + oy * dy + oz * dz)
    x, y, z = ox + nearest * dx, oy + nearest * dy, oz + nearest * dz
    square = x * x + y * y + z * z
    if square >= 1.0:
        return 0
    reach = sqrt(1.0 - square)
    p = 2.0 * (square + (1.0 - tube) * (1.0 - tube) - tube * tube) - 4.0 * (1.0 - tube) * (1.0 - tube) * (
        dx * dx + dy * dy
    )
    q = -8.0 * (1.0 - tube) * (1.0 - tube) * (x * dx + y * dy)
    first, second, third = _extrema(p, q, reach)
    ends = (first, second, third, reach)
    found, entered, low = 0, 0.0, -reach
    within = False
    for i in range(4):
        high = ends[i]
        inside = i < 3 and high < reach and _depth(tube, x + high * dx, y + high * dy, z + high * dz) < 0.0
        if inside != within:
            at = (_surface(tube, (x, y, z), (dx, dy, dz), low, high) + nearest) / length
            if inside:
                entered = at
            elif max(entered, 0.0) < min(at, 1.0):
                events[0, hits + found], events[1, hits + found] = max(entered, 0.0), min(at, 1.0)
                events[2, hits + found] = row
                found += 1
            within = inside
        low = high
    return found
