"""Circular scans of an ideal panel: all that data folders of neural and Gaussian methods can describe."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.conversions.panel_axes import check_pitch, refuse_curved
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from spectra.errors import GeometryError

_SAME = 1e-6  # of the distance to the panel; poses may be so far from the ideal ones


class CentralCircle(NamedTuple):
    """Circular scan whose central ray meets the panel's centre at right angles.

    Parameters
    ----------
    angles : of the source, counter-clockwise from +x [rad]
    sod, sdd : distance from the source to the axis and to the panel [mm]; 0 and the distance from the axis to the panel
        in a parallel beam
    """

    angles: Float[np.ndarray, " view"]
    sod: float
    sdd: float


def central_circle_of(geometry: Geometry, program: str) -> CentralCircle:
    """Describe a scan by angles and two distances.

    Parameters
    ----------
    geometry : poses
    program : its name, for the message

    Returns
    -------
    the description

    Raises
    ------
    GeometryError
        When a view differs from an ideal one; the sentence says in what.
    """
    refuse_curved(geometry, program)
    check_pitch(geometry, program)
    outward = -geometry.normals()
    angles = np.arctan2(outward[:, 1], outward[:, 0])
    behind = float(-np.einsum("vi,vi->v", geometry.panel_center, outward)[0])
    sod = 0.0 if geometry.is_parallel else float(np.einsum("vi,vi->v", geometry.source, outward)[0])
    circle = CentralCircle(angles, sod, sod + behind)
    ideal = central_circle(circle, geometry.panel, geometry.is_parallel)
    panel = geometry.panel
    names = ("ray_direction" if geometry.is_parallel else "source", "column_step", "row_step", "panel_center")
    said = {
        "source": "its source leaves the circle in the plane z = 0",
        "ray_direction": "its rays do not meet the panel at right angles",
        "column_step": "its panel is tilted or turned",
        "row_step": "its panel is tilted or turned",
        "panel_center": "its panel is shifted",
    }
    sizes = {"column_step": panel.column_pitch, "row_step": panel.row_pitch, "ray_direction": 1.0}
    for name in names:
        size = sizes.get(name, max(abs(circle.sdd), 1e-9))
        apart = np.linalg.norm(getattr(geometry, name) - getattr(ideal, name), axis=1)
        if apart.max(initial=0) > _SAME * size:
            view = int(apart.argmax())
            unit = "" if name == "ray_direction" else f" by {apart[view]:.4g} mm"
            raise GeometryError(
                f"{program} can only describe circular scans with a centred upright panel: view {view} is not one, "
                f"{said[name]}{unit} ({geometry.kind} geometry)"
            )
    return circle


def central_circle(circle: CentralCircle, panel: Panel, is_parallel: bool) -> Geometry:
    """Create the poses of a description.

    Parameters
    ----------
    circle : the description
    panel : the pixel grid
    is_parallel : whether the beam is parallel

    Returns
    -------
    poses of all views
    """
    if not is_parallel:
        return Geometry.circular(circle.sod, circle.sdd, circle.angles, panel)
    distance = circle.sdd - circle.sod
    like = Geometry.circular(1.0, 1.0 + max(distance, 1e-9), circle.angles, panel)
    outward = like.source
    return Geometry.parallel(-outward, -distance * outward, like.column_step, like.row_step, panel, circle.angles)
