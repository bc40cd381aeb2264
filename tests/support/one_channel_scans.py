"""Scans with one channel: a cylinder of water, and one with bone and a rod of titanium."""

from pathlib import Path

import yaml

import phantomgen
from phantomgen.dataset.reader import Dataset

WATER = {"type": "cylinder", "material": "water", "radius": 34, "length": 70}
BONE = {"type": "cylinder", "material": "cortical_bone", "center": [-16, 8, 0], "radius": 7, "length": 70}
ROD = {"type": "cylinder", "material": "titanium", "center": [12, -10, 0], "radius": 5, "length": 70}
FAT = {"type": "cylinder", "material": "adipose", "center": [10, 16, 0], "radius": 8, "length": 70}

SCENE = {
    "version": 1,
    "name": "one-channel",
    "source": {"type": "tube", "kvp": 120, "photons": 1e6, "filters": [{"composition": "Al", "thickness": 2.5}]},
    "detector": {"type": "photon_counting", "thresholds": [20]},
    "geometry": {"type": "circular", "sod": 500, "sdd": 800, "views": 60, "test_views": 2},
    "panel": {"rows": 60, "columns": 72, "pitch": 2.5},
    "volume": {"voxels": 40, "size": 80},
    "basis": [{"type": "photoelectric"}, {"type": "compton"}],
    "materials": {
        "water": {"composition": "water"},
        "adipose": {"composition": "adipose"},
        "cortical_bone": {"composition": "cortical bone"},
        "titanium": {"composition": "Ti"},
    },
}


def one_channel_scan(path: Path, *objects: dict, **changes: object) -> Dataset:
    """Simulate a scan of these objects, the later ones over the earlier ones."""
    scene = path.with_suffix(".yaml")
    scene.write_text(yaml.safe_dump({**SCENE, "objects": list(objects), **changes}))
    return phantomgen.make(scene, out=path, overwrite=True)
