"""Pictures of all presets, for `docs/reference/presets.md`: an axial slice, a coronal slice, and one projection.

    python docs/development/make_thumbnails.py [PRESET ...]

Slices show the attenuation at 70 keV, averaged over pixels; x runs to the right, y and z upwards. The projection is the
line integral at 70 keV from the first view. Nothing random is in them, so the same program makes the same pictures.
"""

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from phantomgen.geometry.curved_panel import ray_directions
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.scene.file.scene_file import SceneFile, preset_names
from phantomgen.scene.scan import Scan, load_scene

FOLDER = Path(__file__).parents[1] / "images" / "presets"
PIXELS, GAP = 216, 6
ENERGY = 70.0
WATER = 0.0193  # 1/mm at 70 keV
# Where slices cut (x, y, z) [mm], and the window of grey values in multiples of water; else the centre, and all values.
PLACES = {
    "breathing-torso": (0, -3, 0),
    "perfusion": (0, -30, 0),
    "aorta": (-3, -12, -4),
    "bird-chest": (0, 1, 2),
    "clinical-helix": (0, -20, 0),
    "defrise": (0, 0, 7.1),
    "forbild-head": (0, 0, 0.1),
    "head": (0, 0, -4),
    "kedge": (0, -6, 0),
    "kedge-physical": (0, -6, 0),
    "kedge-small": (0, -6, 0),
    "kedge-sphere": (0, -6, 0),
    "line-pairs": (0, 0, 1),
    "metal-hip": (0, 0, -20),
    "multi-energy": (0, 25, 0),
    "shepp-logan-3d": (0, -8, -25),
}
WINDOWS = {
    "breathing-torso": (0, 1.6),
    "perfusion": (0.8, 1.5),
    "aorta": (0, 2.0),
    "bird-chest": (0, 3.0),
    "chest": (0, 1.6),
    "clinical-helix": (0.8, 1.6),
    "contrast-vials": (0.8, 3.0),
    "dl-spectral-breast": (0.8, 1.2),
    "forbild-head": (0.95, 1.15),
    "head": (0.9, 1.4),
    "metal-hip": (0, 4),
    "multi-energy": (0.7, 2.0),
    "shepp-logan-3d": (0.96, 1.08),
}


SHOWN = 0.35  # part of the duration of a scene in time, at which it is shown
FRONT = (("foam", "shepp-logan-3d"), ("aorta", "bird-chest"))


def slices(scan: Scan, at: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Attenuation [1/mm] in an axial and a coronal plane through a point, top rows first."""
    size = scan.grid.shape[2] * scan.grid.spacing[2]
    step = size / PIXELS
    first = (step - size) / 2
    axial = Grid((1, PIXELS, PIXELS), (step, step, step), (at[2], first, first))
    coronal = Grid((PIXELS, 1, PIXELS), (step, step, step), (first, at[1], first))
    filled = [scan.scene.fractions(grid) for grid in (axial, coronal)]
    seen, behind = (np.tensordot(attenuation(scan), volume, 1) for volume in filled)
    return seen[0, ::-1], behind[::-1, 0]


def projection(scan: Scan) -> np.ndarray:
    """Line integrals of the first view on a square panel that holds the real one."""
    panel = scan.geometry.panel
    side = max(panel.rows * panel.row_pitch, panel.columns * panel.column_pitch)
    places = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * side
    columns = (panel.columns - 1) / 2 + places / panel.column_pitch
    rows = (panel.rows - 1) / 2 + places / panel.row_pitch
    rays = ray_directions(scan.geometry[[0]], columns, rows).reshape(-1, 3)
    origins = np.broadcast_to(scan.geometry.source[0], rays.shape)
    lengths = scan.scene.path_lengths(origins, rays)
    return (lengths @ attenuation(scan)).reshape(PIXELS, PIXELS)


def attenuation(scan: Scan) -> np.ndarray:
    """Of the materials at 70 keV [1/mm]."""
    return np.array([m.attenuation(np.array([ENERGY]), scan.basis)[0] for m in scan.scene.materials])


def grey(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Values as bytes."""
    return np.round(255 * np.clip((values - low) / (high - low), 0, 1)).astype(np.uint8)


def thumbnail(name: str) -> np.ndarray:
    """One picture: three squares side by side."""
    time = SceneFile.preset(name).model.time
    scan = load_scene(name, ["geometry.views=1", "geometry.test_views=0", *(["time.phases=null"] if time else [])])
    if time is not None:
        scan = scan.at_time(SHOWN * time.duration)
    axial, coronal = slices(scan, PLACES.get(name, (0, 0, 0)))
    shadow = projection(scan)
    low, high = (WATER * value for value in WINDOWS.get(name, (0, np.inf)))
    high = min(high, float(max(axial.max(), coronal.max())))
    gap = np.full((PIXELS, GAP), 255, np.uint8)
    dark = grey(shadow, 0, float(np.quantile(shadow, 0.999)))
    return np.hstack([grey(axial, low, high), gap, grey(coronal, low, high), gap, dark])


def gallery() -> np.ndarray:
    """Four of the pictures, two by two, for the front page."""
    (a, b), (c, d) = ([np.array(Image.open(FOLDER / f"{name}.png")) for name in pair] for pair in FRONT)
    gap = np.full((PIXELS, GAP), 255, np.uint8)
    rows = np.hstack([a, gap, b]), np.hstack([c, gap, d])
    return np.vstack([rows[0], np.full((GAP, rows[0].shape[1]), 255, np.uint8), rows[1]])


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for preset in sys.argv[1:] or preset_names():
        picture = FOLDER / f"{preset}.png"
        Image.fromarray(thumbnail(preset)).save(picture, optimize=True)
        print(picture, picture.stat().st_size // 1000, "kB")
    Image.fromarray(gallery()).save(FOLDER / "gallery.png", optimize=True)
