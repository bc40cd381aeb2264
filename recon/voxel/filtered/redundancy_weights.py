"""Weights of rays that a circular orbit measures more than once, relative to the two of a full circle."""

import numpy as np
from jaxtyping import Float


def half_fan_weights(
    across: Float[np.ndarray, "*view column"], overlap: float, distance: float
) -> Float[np.ndarray, "*view column"]:
    """Compute the weights of a panel that covers one side of the axis fully, and the other up to `overlap`.

    The weights rise smoothly from 0 to 2 over the part of the panel that covers both sides, and those of opposite
    columns add up to 2.

    Parameters
    ----------
    across : position of the columns from the central ray, positive on the side that is covered fully [mm]
    overlap : width of the panel beyond the axis on the other side [mm]
    distance : distance from the source to the plane in which `across` and `overlap` are measured [mm]

    Returns
    -------
    weight of each column, from 0 to 2

    References
    ----------
    Wang 2002, doi:10.1118/1.1489043.
    """
    part = np.arctan(across / distance) / np.arctan(overlap / distance)
    return 1 + np.sin(np.pi / 2 * np.clip(part, -1, 1))


def parker_weights(
    angles: Float[np.ndarray, " view"], fan: Float[np.ndarray, "view column"], spare: float
) -> Float[np.ndarray, "view column"]:
    """Compute the weights of an arc of half a turn and `2 spare`, which add up to 2 over the two views of a ray.

    If `spare` is half the fan of the panel, the weights are those of Parker; longer arcs use their whole overlap, as
    proposed by Silver.

    Parameters
    ----------
    angles : angle of the source from the beginning of the arc [rad]
    fan : fan angle of each column from the central ray, counter-clockwise as seen from the path of the source [rad]
    spare : half of the arc beyond half a turn [rad]

    Returns
    -------
    weight of each view and column, from 0 to 2

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
