"""Weights of rays that a circular orbit meets more than once, relative to a full circle, which meets all twice."""

import numpy as np
from jaxtyping import Float


def half_fan_weights(
    across: Float[np.ndarray, "*view column"], overlap: float, distance: float
) -> Float[np.ndarray, "*view column"]:
    """Weights of a panel that sees one side of the axis fully, and the other up to `overlap`.

    They rise from 0 to 2 over the part of the panel that is seen from both sides, smoothly, and those of opposite
    columns add up to 2.

    Parameters
    ----------
    across : position of the columns from the central ray, positive on the side that is seen fully [mm]
    overlap : how far the panel reaches to the other side [mm]
    distance : from source to panel, the same as that in which lengths on the panel are given [mm]

    References
    ----------
    Wang 2002, doi:10.1118/1.1489043.
    """
    part = np.arctan(across / distance) / np.arctan(overlap / distance)
    return 1 + np.sin(np.pi / 2 * np.clip(part, -1, 1))


def parker_weights(
    angles: Float[np.ndarray, " view"], fan: Float[np.ndarray, "view column"], spare: float
) -> Float[np.ndarray, "view column"]:
    """Weights of an arc of half a turn and `2 spare`; those of the two views of a ray add up to 2.

    With the fan of the panel for `spare` they are Parker's; longer arcs take all of their overlap, as Silver proposed.

    Parameters
    ----------
    angles : of the source from the beginning of the arc [rad]
    fan : fan angle of each column from the central ray, counter-clockwise as seen from the source's path [rad]
    spare : half of what the arc has beyond half a turn [rad]

    References
    ----------
    Parker 1982, doi:10.1118/1.595078; Silver 2000, doi:10.1118/1.599080.
    """
    spare = max(spare, 1e-6)
    fan = -np.clip(fan, -0.999 * spare, 0.999 * spare)  # rays beyond pass beside the object
    angle = angles[:, None]
    rise = np.clip(angle / (spare - fan), 0, 2)
    fall = np.clip((np.pi + 2 * spare - angle) / (spare + fan), 0, 2)
    return 2 * np.sin(np.pi / 4 * np.minimum(rise, fall)) ** 2
