"""A scene with something of everything, and the options that keep any scene tiny."""

TINY = ("--voxels", "4", "--set", "panel={rows: 4, columns: 4, pitch: 40}", "--set", "volume.size=128")
SCENE = {
    "version": 1,
    "name": "tiny",
    "source": {"type": "tube", "kvp": 100, "photons": 1.0e5, "filters": [{"composition": "Al", "thickness": 2.5}]},
    "detector": {"type": "photon_counting", "composition": "CdTe", "thickness": 1.6, "thresholds": [20, 45]},
    "geometry": {"type": "circular", "sod": 500, "sdd": 800, "views": 3, "test_views": 1},
    "panel": {"rows": 4, "columns": 4, "pitch": 40},
    "volume": {"voxels": 4, "size": 128},
    "basis": [{"type": "photoelectric"}, {"type": "compton"}],
    "effects": {"blur": {"fwhm": 20}, "focal_spot": {"width": 1, "height": 1}},
    "objects": [
        {"type": "sphere", "material": "water", "radius": 40, "center": [5, 0, 0]},
        {"type": "tube", "material": "Al", "radius": 20, "inner_radius": 15, "length": 30, "axis": [1, 2, 3]},
        {"type": "difference", "material": "water", "base": {"type": "box", "size": [9, 9, 9]}, "cut": [
            {"type": "cone", "radii": [3, 1], "length": 4},
        ]},
    ],
    "seed": 0,
    "flats": 2,
    "darks": 1,
}  # fmt: skip
