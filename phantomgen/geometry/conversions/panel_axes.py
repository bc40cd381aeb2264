"""Unit axes of panels, and a `Geometry` from the vectors of another program."""

import numpy as np
from jaxtyping import Float

from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry, VectorPerView
from spectra.errors import GeometryError

_SAME = 1e-6  # relative; pixels of one panel may differ by so much between views
_SQUARE = 1e-6  # cosine of the angle between columns and rows that counts as a right angle


def unit_steps(geometry: Geometry) -> tuple[VectorPerView, VectorPerView]:
    """Return the directions along which columns and rows count.

    Parameters
    ----------
    geometry : poses

    Returns
    -------
    unit vectors to the next column and to the next row
    """
    steps = geometry.column_step, geometry.row_step
    column, row = (step / np.linalg.norm(step, axis=1, keepdims=True) for step in steps)
    return column, row


def right_angled_steps(geometry: Geometry, program: str, curved: bool = False) -> tuple[VectorPerView, VectorPerView]:
    """Return the directions along which columns and rows count, for a program whose panels are rectangles.

    Parameters
    ----------
    geometry : poses
    program : its name, for the message
    curved : whether it knows curved panels

    Returns
    -------
    unit vectors to the next column and to the next row; of a curved panel, in its middle

    Raises
    ------
    GeometryError
        When the panel is curved and may not be, the pixels of a view are no rectangles, or their size is not that of
        the panel.
    """
    if not curved:
        refuse_curved(geometry, program)
    check_pitch(geometry, program)
    column, row = unit_steps(geometry)
    cosine = np.abs(np.einsum("vi,vi->v", column, row))
    if cosine.max(initial=0) > _SQUARE:
        view = int(cosine.argmax())
        raise GeometryError(
            f"{program} needs columns and rows at right angles: those of view {view} are "
            f"{np.rad2deg(np.arccos(cosine[view])):.6g} degrees apart"
        )
    return column, row


def check_pitch(geometry: Geometry, program: str) -> None:
    """Refuse steps that are not as long as the pitch of the panel, for programs that have one pitch for all views.

    Parameters
    ----------
    geometry : poses
    program : its name, for the message

    Raises
    ------
    GeometryError
        When a step of a view has another length.
    """
    panel = geometry.panel
    for name, pitch in (("column_step", panel.column_pitch), ("row_step", panel.row_pitch)):
        length = np.linalg.norm(getattr(geometry, name), axis=1)
        bad = np.flatnonzero(np.abs(length - pitch) > _SAME * pitch)
        if len(bad):
            raise GeometryError(
                f"{program} has one pixel size for all views: {name} of view {bad[0]} is {length[bad[0]]:.7g} mm long, "
                f"and the pitch of the panel is {pitch:g} mm"
            )


def refuse_curved(geometry: Geometry, program: str) -> None:
    """Refuse a curved panel, for programs that have flat ones.

    Parameters
    ----------
    geometry : poses
    program : its name, for the message

    Raises
    ------
    GeometryError
        When the panel is curved.
    """
    if geometry.panel.curvature is not None:
        raise GeometryError(
            f"{program} knows flat panels only, and this one has a radius of {geometry.panel.curvature.radius:g} mm: "
            "resample line integrals to a flat panel (--flat-panel)"
        )


def refuse_parallel(geometry: Geometry, program: str) -> None:
    """Refuse a parallel beam, for programs whose rays leave a point.

    Parameters
    ----------
    geometry : poses
    program : its name, for the message

    Raises
    ------
    GeometryError
        When the beam is parallel.
    """
    if geometry.is_parallel:
        raise GeometryError(f"{program} has no parallel beam with free poses: its rays leave a source point")


def geometry_of(
    panel_center: VectorPerView,
    column_step: VectorPerView,
    row_step: VectorPerView,
    size: tuple[int, int],
    source: VectorPerView | None = None,
    ray_direction: VectorPerView | None = None,
    angles: Float[np.ndarray, " view"] | None = None,
) -> Geometry:
    """Create a geometry whose panel has the pitch of the steps.

    Parameters
    ----------
    panel_center, column_step, row_step : of each view [mm]
    size : number of rows and of columns
    source : source points [mm]; left out in a parallel beam
    ray_direction : vectors of any length along the rays of a parallel beam, away from the source
    angles : rotation angles of the views [rad], where the program has them

    Returns
    -------
    poses of all views

    Raises
    ------
    GeometryError
        When the pitch differs between views, or the poses are impossible.
    """
    pitch = []
    for name, step in (("row step", row_step), ("column step", column_step)):
        length = np.linalg.norm(step, axis=1)
        if not len(length) or length.min() <= 0:
            raise GeometryError(f"every view needs a {name} that is not zero, of at least one view")
        if np.ptp(length) > _SAME * length.max():
            raise GeometryError(
                f"a panel has one pitch in all views: the {name} is {length.min():.7g} mm long in one view and "
                f"{length.max():.7g} mm in another"
            )
        pitch.append(float(length[0]))
    panel = Panel(*size, (pitch[0], pitch[1]))
    if source is not None:
        known = np.empty(0) if angles is None else angles
        return Geometry(source, panel_center, column_step, row_step, panel, known)
    direction = np.asarray(ray_direction, dtype=np.float64)
    direction = direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return Geometry.parallel(direction, panel_center, column_step, row_step, panel, angles)
