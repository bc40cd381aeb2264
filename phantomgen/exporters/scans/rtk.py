"""Folder for RTK: its geometry file, and one MetaImage (.mha) of projections per channel."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from jaxtyping import Float

from phantomgen.exporters.projections import Kind, Projections
from phantomgen.exporters.scans.arrays import file_name, fill
from phantomgen.geometry.conversions.rtk import RtkGeometry, rtk_matrices, to_rtk
from phantomgen.geometry.panel import Panel

KINDS: tuple[Kind, ...] = ("line-integrals",)
_LOAD = """
scan, name = load()
kind, geometry = itk.Image[itk.F, 3], rtk.read_geometry("geometry.xml")
data = itk.imread(f"{scan['files'][name]}.mha", itk.F)
grid = {key: [v[i] for i in (1, 0, 2)] for key, v in scan["grid"].items()}  # RTK's (x, y, z) are our (y, z, x)
empty = rtk.constant_image_source(origin=grid["origin"], spacing=grid["spacing"], size=grid["shape"], ttype=[kind])
"""
_SAVE = """np.save(f"{scan['files'][name]}_volume.npy", itk.array_from_image(volume).transpose(1, 2, 0))  # (z, y, x)
"""
_FDK = """data = rtk.displaced_detector_image_filter(data, geometry=geometry)  # nothing where the panel is centred
data = rtk.parker_short_scan_image_filter(data, geometry=geometry)  # nothing on a full circle
volume = rtk.fdk_cone_beam_reconstruction_filter(empty, data, geometry=geometry)
"""
_GRADIENTS = """fit = rtk.ConjugateGradientConeBeamReconstructionFilter[kind].New(Geometry=geometry)
fit.SetNumberOfIterations(20)
fit.SetForwardProjectionFilter(fit.ForwardProjectionType_FP_JOSEPH)
fit.SetBackProjectionFilter(fit.BackProjectionType_BP_JOSEPH)
fit.SetDisableDisplacedDetectorFilter(True)  # which knows flat panels only, as RTK's FDK does
fit.SetInputVolume(empty)
fit.SetInputProjectionStack(data)
fit.SetInputWeights(rtk.constant_image_source(information_from_image=data, constant=1.0, ttype=[kind]))
fit.Update()
volume = fit.GetOutput()
"""
SCRIPT, CURVED_SCRIPT = _LOAD + _FDK + _SAVE, _LOAD + _GRADIENTS + _SAVE
IMPORTS = "import itk\nfrom itk import RTK as rtk"


def write(folder: Path, projections: Projections) -> dict[str, Any]:
    """Write ``geometry.xml`` and the projections.

    Parameters
    ----------
    folder : that gets the files
    projections : what to write

    Returns
    -------
    what the script needs to know: nothing
    """
    (folder / "geometry.xml").write_text(geometry_xml(to_rtk(projections.geometry)), encoding="utf-8")
    stacks = [
        new_mha(folder / f"{file_name(n)}.mha", len(projections), projections.geometry.panel) for n in projections.names
    ]
    fill(projections, [stack[:, ::-1] for stack in stacks])
    for stack in stacks:
        stack.flush()
    return {}


def geometry_xml(rtk: RtkGeometry) -> str:
    """Write RTK's geometry file, version 3.

    Parameters
    ----------
    rtk : nine numbers per view

    Returns
    -------
    the text; numbers that are equal in all views stand at the top, as RTK writes them
    """
    lines = ['<?xml version="1.0"?>', "<!DOCTYPE RTKGEOMETRY>", '<RTKThreeDCircularGeometry version="3">']
    numbers = {name: values for name, values in vars(rtk).items() if isinstance(values, np.ndarray)}
    common = [name for name, values in numbers.items() if name != "GantryAngle" and (values == values[0]).all()]
    lines += [_element("  ", name, numbers[name][0]) for name in common]
    if rtk.RadiusCylindricalDetector:
        lines.append(_element("  ", "RadiusCylindricalDetector", rtk.RadiusCylindricalDetector))
    for view, matrix in enumerate(rtk_matrices(rtk)):
        own = [_element("    ", name, numbers[name][view]) for name in numbers if name not in common]
        rows = ["      " + " ".join(f"{value:.15g}" for value in row) for row in matrix]
        lines += ["  <Projection>", *own, "    <Matrix>", *rows, "    </Matrix>", "  </Projection>"]
    return "\n".join([*lines, "</RTKThreeDCircularGeometry>", ""])


def new_mha(path: Path, views: int, panel: Panel) -> Float[np.memmap, "view row column"]:
    """Create a MetaImage of projections whose physical origin is the panel's centre, to be filled.

    Parameters
    ----------
    path : of the file
    views : number of views
    panel : the pixel grid

    Returns
    -------
    the values, rows upwards
    """

    def triple(values: Sequence[float]) -> str:
        return " ".join(f"{value:.15g}" for value in values)

    first = [-(n - 1) / 2 * p for n, p in ((panel.columns, panel.column_pitch), (panel.rows, panel.row_pitch))]
    header = "\n".join(
        [
            "ObjectType = Image",
            "NDims = 3",
            "BinaryData = True",
            "BinaryDataByteOrderMSB = False",
            "CompressedData = False",
            "TransformMatrix = 1 0 0 0 1 0 0 0 1",
            f"Offset = {triple([*first, 0.0])}",
            "CenterOfRotation = 0 0 0",
            f"ElementSpacing = {triple([panel.column_pitch, panel.row_pitch, 1.0])}",
            f"DimSize = {panel.columns} {panel.rows} {views}",
            "ElementType = MET_FLOAT",
            "ElementDataFile = LOCAL",
            "",
        ]
    )
    path.write_bytes(header.encode("ascii"))
    return np.memmap(path, np.dtype("<f4"), "r+", len(header), (views, panel.rows, panel.columns))


def _element(indent: str, name: str, value: float) -> str:
    return f"{indent}<{escape(name)}>{value:.15g}</{escape(name)}>"
