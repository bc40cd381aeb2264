"""A scan of iodine in water with compositions, whose truth has no symmetry."""

from pathlib import Path

from click.testing import CliRunner

from phantomgen.cli.main import main as phantomgen

SCENE = """\
version: 1
name: agents
source: {type: tube, kvp: 120, photons: 100000}
detector: {type: photon_counting, thresholds: [20, 33.2, 60]}
geometry: {type: circular, sod: 500, sdd: 800, views: 4, test_views: 1}
panel: {rows: 8, columns: 16, pitch: 4}
volume: {voxels: 8, size: 32}
basis: [{type: photoelectric}, {type: compton}, {type: element, element: I}]
materials:
  water: {composition: "Water, Liquid"}
  iodine_10: {solution: {solvent: water, solutes: {I: 10}}}
objects:
  - {type: cylinder, material: water, radius: 12, length: 24}
  - {type: box, material: iodine_10, center: [4, -4, 2], size: [8, 4, 12]}
"""


def agent_scan(folder: Path) -> Path:
    """Simulate the scan in a folder."""
    (folder / "agents.yaml").write_text(SCENE)
    result = CliRunner().invoke(phantomgen, ["make", str(folder / "agents.yaml"), "-o", str(folder / "a.h5"), "-q"])
    assert result.exit_code == 0, result.output
    return folder / "a.h5"
