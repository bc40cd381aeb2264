"""A training set of random phantoms: item N depends on N only, so items can be made in any order and on any machine.

    python examples/training_set.py 3

makes the items 0 to 2 as ``training/item0000.h5`` and so on, and skips those that are there.
"""

import sys
from pathlib import Path

from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate

ITEMS = int(sys.argv[1]) if len(sys.argv) > 1 else 3
FOLDER = Path("training")
# Small, so that the example takes seconds; leave the overrides out for the whole preset.
SMALL = ["geometry.views=12", "geometry.test_views=2", "panel={rows: 64, columns: 64, pitch: 3.2}", "volume.voxels=32"]

FOLDER.mkdir(exist_ok=True)
for item in range(ITEMS):
    path = FOLDER / f"item{item:04d}.h5"
    if path.exists():
        continue
    scan = load_scene("random", [f"seed={item}", *SMALL])
    summary = simulate(scan, path)
    print(f"{path}: {len(scan.scene.objects)} objects, {sum(summary.seconds.values()):.1f} s")
