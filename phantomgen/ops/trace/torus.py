"""Where a ray runs inside a torus.

Along a ray of unit direction, measured from the point nearest to the centre, the implicit quartic has no cubic term.
Its extrema, roots of a cubic, bracket the roots; these are then sought on the distance from the ring,
``(h - R)^2 + z^2 - r^2``, which does not cancel like the quartic does.
"""

from math import acos, cos, pi, sqrt
from typing import no_type_check

from phantomgen.ops.kernel_decorators import called, inlined

# Relative room for rounding where a ray is found not to meet a torus, without solving for its ends.
_MARGIN = 1e-9
# Safeguarded Newton iterations; bisection alone would reach the rounding of a float64 (53 bits) with as many.
_STEPS = 60
# In local units, where the torus has the radius 1: a step that is only rounding, and one below which steps that do not
# get shorter are.
_ROUNDING, _CLOSE = 4e-16, 1e-6
_THIRD_OF_A_TURN = 2.0 * pi / 3.0


@inlined
@no_type_check
def _depth(tube, x, y, z):
    """Square of the distance from the ring minus that of the tube's radius: negative inside."""
    h = sqrt(x * x + y * y) - (1.0 - tube)
    return h * h + (z - tube) * (z + tube)


@inlined
@no_type_check
def _polished(p, q, t):
    """Zero of ``4 t^3 + 2 p t + q`` near `t`, by one step of Newton's method."""
    slope = 12.0 * t * t + 2.0 * p
    return t - ((4.0 * t * t + 2.0 * p) * t + q) / slope if slope != 0.0 else t


@inlined
@no_type_check
def _extrema(p, q, reach):
    """Extrema of ``t^4 + p t^2 + q t`` between -reach and reach, ascending; those missing are `reach`."""
    third_of_linear, half_constant = p / 6.0, q / 8.0  # of the cubic t^3 + 3 (p / 6) t + 2 (q / 8)
    discriminant = half_constant * half_constant + third_of_linear * third_of_linear * third_of_linear
    if discriminant > 0.0:
        larger = (abs(half_constant) + sqrt(discriminant)) ** (1.0 / 3.0)
        t = larger - third_of_linear / larger
        t = _polished(p, q, -t if half_constant > 0.0 else t)
        return (t, reach, reach) if -reach < t < reach else (reach, reach, reach)
    radius = sqrt(-third_of_linear)
    cosine = -half_constant / (radius * radius * radius) if radius > 0.0 else 1.0
    angle = acos(min(1.0, max(-1.0, cosine))) / 3.0
    last = _polished(p, q, 2.0 * radius * cos(angle))
    first = _polished(p, q, 2.0 * radius * cos(angle + _THIRD_OF_A_TURN))
    middle = -first - last
    if first <= -reach:  # move those inside before those that are not
        first, middle, last = middle, last, reach
    if first <= -reach:
        first, middle = middle, reach
    if first <= -reach:
        first = reach
    return min(first, reach), min(middle, reach), min(last, reach)


@called
@no_type_check
def _surface(tube, point, direction, low, high, inside_first):
    """Where the ray crosses the surface between `low` and `high`, one of which lies inside, by Newton's method.

    It begins where the squared distance from the ring, as a parabola at the end inside, reaches the surface; half of
    what is left replaces steps that leave it.
    """
    x, y, z = point
    dx, dy, dz = direction
    across, t, last_step = dx * dx + dy * dy, 0.5 * (low + high), high - low
    begin = low if inside_first else high
    px, py, pz = x + begin * dx, y + begin * dy, z + begin * dz
    h, along = sqrt(px * px + py * py), px * dx + py * dy
    if h > 0.0:
        bend = dz * dz + along * along / (h * h) + (h - (1.0 - tube)) * (across - along * along / (h * h)) / h
        depth = _depth(tube, px, py, pz)
        if bend > 0.0 and depth < 0.0:
            guess = begin + sqrt(-depth / bend) if inside_first else begin - sqrt(-depth / bend)
            t = min(max(guess, low), high)
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
        change = abs(step - t)
        if change <= _ROUNDING or (change < _CLOSE and change > 0.5 * last_step):
            break
        last_step = change
        if not low <= step <= high:
            step, last_step = 0.5 * (low + high), high - low
        t = step
    return t


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
            at = (_surface(tube, (x, y, z), (dx, dy, dz), low, high, within) + nearest) / length
            if inside:
                entered = at
            elif max(entered, 0.0) < min(at, 1.0):
                events[0, hits + found], events[1, hits + found] = max(entered, 0.0), min(at, 1.0)
                events[2, hits + found] = row
                found += 1
            within = inside
        low = high
    return found
