"""Text of scene files that importers of phantoms write: the scan around a phantom, and values on one line."""

from math import ceil, sqrt
from typing import Any

import yaml

# Distance to the panel over that to the axis, room beside the phantom, and columns of the panel.
_MAGNIFICATION, _ROOM, _COLUMNS = 1.6, 1.02, 256

BEAM = (
    "source:\n  type: tube\n  kvp: 120\n  filters:\n    - {composition: Al, thickness: 2.5}\n  photons: 1000000.0\n\n"
    "detector: {type: photon_counting, composition: CdTe, thickness: 1.6, thresholds: [25, 65]}\n\n"
)


def nominal_scan(radius: float, height: float, reach: float, views: int) -> str:
    """Write distances, panel and volume of a scan that sees a whole phantom.

    Half the cone angle is at most about 17 degrees.

    Parameters
    ----------
    radius : of a cylinder about the rotation axis that holds the phantom [mm]
    height : largest distance of the phantom from the plane of the orbit [mm]
    reach : half an edge of a cube around the isocentre that holds the phantom [mm]
    views : number of training views; a fifth as many, at most 15, are test views

    Returns
    -------
    lines of a scene file
    """
    sod = 50.0 * ceil(max(500.0, 3.5 * radius, 3.5 * height) / 50)
    sdd = _MAGNIFICATION * sod
    half_width = sdd * radius / sqrt(sod**2 - radius**2)
    pitch = ceil(100 * 2 * _ROOM * half_width / _COLUMNS) / 100
    rows = 2 * ceil(_ROOM * sdd * height / (sod - radius) / pitch)
    return (
        f"geometry: {{type: circular, sod: {sod:g}, sdd: {sdd:g}, views: {views}, test_views: {min(views // 5, 15)}}}\n"
        f"panel: {{rows: {rows}, columns: {_COLUMNS}, pitch: {pitch:g}}}\n"
        f"volume: {{voxels: 128, size: {ceil(2 * _ROOM * reach)}}}\n"
    )


def flow(value: Any) -> str:
    """Write a value as YAML on one line.

    Parameters
    ----------
    value : of plain types

    Returns
    -------
    the text
    """
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10**6).removesuffix("...\n").strip()
