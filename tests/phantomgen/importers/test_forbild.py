"""FORBILD files: the head against the preset, macros and includes, and one sentence per mistake."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from phantomgen.cli.main import main
from phantomgen.importers.forbild import forbild_scene
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.checks.field_of_view import coverage_warnings
from spectra.errors import SceneError

# The head with its numbers as they are published, but for the patterns of many small cells.
HEAD = """
#define MAT(dens) formel=H2O dichte=dens
Phantom
{ "5" [Ellipsoid: dx=9.6 dy=12 dz=12.5 ] MAT(1.8) }   /* the
skull */
{ "6" [Ellipsoid: dx=9.0 dy=11.4 dz=11.9 ] MAT(1.050) }
{ "12"[Ellipsoid: y=-3.6 dx=1.8 dy= 3.6 dz= 3.6 ] MAT(1.045) }
{ "7" [Ellipsoid: y= 8.4 dx=1.8 dy= 3.0 dz= 3.0 ] MAT(0) }
{ "1" [Sphere: x=-4.7 y= 4.3 z= 0.872 r=2.0] MAT(1.060) }
{ "2" [Sphere: x= 4.7 y= 4.3 z= 0.872 r=2.0] MAT(1.060) }
{ "3" [Sphere: x=-1.08 y=-9 r=0.4] MAT(1.0525) }
{ "4" [Sphere: x= 1.08 y=-9 r=0.4] MAT(1.0475) }
{ "14"[Ellipt_Cyl: y=3.6 dx=1.2 dy=4.0 l=0.5*cos(15)
       achse(0,-cos(30),sin(30)) a_y(0,sin(30),cos(30))] MAT(1.8) }
{ "15"[Ellipt_Cyl: y=9.6 dx=0.525561 dy=2. l=0.4 axis(1,0,0) a_y(0,-sin(30),cos(30))] MAT(1.8) }
{ "8" [Ellipsoid_free: x=-1.9 y=5.4 dx=1.206483*cos(15) dy=0.420276*cos(15) dz=3.0
       a_z(sin(15),0,cos(15)) a_x(cos(15)*cos(120),sin(120),-sin(15)*cos(120))] MAT(1.8) }
{ "9" [Ellipsoid_free: x=1.9 y=5.4 dx=1.2*cos(15) dy=0.42*cos(15) dz=3.0
       a_z(-sin(15),0,cos(15)) a_x(cos(15)*cos(60),sin(60),sin(15)*cos(60))] MAT(1.8) }
{ "10"[Ellipt_Cyl: x=-4.3 y=6.8 z=-1. dx=1.8 dy=0.24 l=4.0 axis(0,0,1) a_x(cos(150),sin(150),0) ] MAT(1.8) }
{ "11"[Ellipt_Cyl: x=4.3 y=6.8 z=-1. dx=1.8 dy=0.24 l=4.0 axis(0,0,1) a_x(cos(30),sin(30),0) ] MAT(1.8) }
{ "13"[Ellipsoid_free: x=6.393945 y=-6.393945 dx=1.2 dy=0.42 dz=1.2 a_x(cos(58.1),sin(58.1),0) a_z(0,0,1)] MAT(1.055) }
{ "16"[Cone_y: y=-11.15 z=-0.2 r1=0.5 r2=0.2 l=1.5 ] MAT(1.8) }
{ "17"[Cone_y: y=-11.15 z= 0.2 r1=0.5 r2=0.2 l=1.5] MAT(1.8) }
{ [Ellipsoid: x=9.1 dx=4.2 dy=1.8 dz=1.8 x<9.1] MAT(1.8) } // right ear
"""


def scene_of(folder: Path, text: str, name: str = "phantom.pha") -> SceneFile:
    (folder / name).write_text(text, encoding="utf-8")
    return SceneFile("phantom.yaml", forbild_scene(folder / name))


def densities(scan, points: np.ndarray, count: int | None = None) -> np.ndarray:
    found = np.zeros(len(points))
    for shape, material in scan.scene.objects[:count]:
        found[shape.contains(points)] = scan.scene.materials[material].density or 0.0
    return found


def test_the_head_is_the_preset(tmp_path: Path) -> None:
    scan = load_scene(scene_of(tmp_path, HEAD))
    preset = load_scene("forbild-head", ["geometry.views=1", "geometry.test_views=0"])
    objects = HEAD.count("[")
    assert len(scan.scene.objects) == objects
    rng = np.random.default_rng(0)
    centres = [np.mean(shape.bounds, axis=0) for shape, _ in scan.scene.objects]
    points = np.concatenate([rng.uniform(-125, 125, (20000, 3)), *(rng.normal(c, 12, (2000, 3)) for c in centres)])
    ours, theirs = densities(scan, points), densities(preset, points, objects)
    assert len(set(ours)) == 8
    # the preset rounds angles to 1e-4 degrees, so a few points next to a surface may differ
    assert (ours != theirs).sum() <= 2
    assert coverage_warnings(scan) == []


def test_includes_macros_and_tissues(tmp_path: Path) -> None:
    (tmp_path / "Tissues").write_text(
        "// a table\n#define SPONGIOSA 1.180 // HU\n#define LIVER   1.05\n", encoding="utf-8"
    )
    text = """\
# 1 "Body.pha"
# 1 "<command-line>" 1 3 4
#include "Tissues"
#define VERTEBRA(X,Y,height)\\
Phantom \\
{ [ Cylinder_z: x=X y=Y-1.4 l=height r=1.75 r(0,3,0)>Y-1.35 ] formula=H2O rho=SPONGIOSA } \\
{ [ Box: x=X+2 y=Y dx=2*sqrt(4) dy=.2 dz=height union=-1 ] formula=H2O rho=SPONGIOSA }
#define REL
Text "body"
Phantom
{ [Sphere: x=-3 r=1] formula=H2O rho=LIVER REL }
VERTEBRA(1,-(2+3),2)
{ [Cylinder: axis(3,7,0) l=22 r=1 ] rho=0.5 union=-1 }
"""
    file = scene_of(tmp_path, text)
    model = file.model
    assert model.materials["liver"].density == 1.05
    assert model.materials["spongiosa"].composition == "H2O"
    assert model.materials["rho_0.5"].coefficients == pytest.approx({"photoelectric": 0.00069, "compton": 0.00894})
    _, cylinder, box, rod = (shape for shape, _ in load_scene(file).scene.objects)
    np.testing.assert_allclose(box.bounds, [[10, -51, -10], [50, -49, 10]])
    inside = cylinder.contains(np.array([[10.0, -63, 0], [10.0, -64, 0]]))
    assert inside.tolist() == [True, False]  # y > -6.35 cm
    assert rod.contains(np.array([[3, 7, 0], [7, -3, 5]]) * 10.0).tolist() == [True, False]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{ [Sphere: r=1] rho=1 ", "f.pha:1:21: name is expected here, got 'the end of the file'"),
        ("\n { [Spere: r=1] rho=1 }", "f.pha:2:5: unknown type 'Spere'; did you mean 'Sphere'?"),
        ("{ [Sphere: rr=1] rho=1 }", "f.pha:1:4: Sphere has no 'rr': choose from r, x, y, z"),
        ("{ [Sphere: r=1 r=2] rho=1 }", "f.pha:1:16: 'r' stands twice"),
        ("{ [Sphere: x=1] rho=1 }", "f.pha:1:4: Sphere needs r > 0, got 0"),
        ("{ [Sphere: r=1] rho=BONE }", "f.pha:1:21: 'BONE' is no number, and no macro defines it"),
        ("{ [Sphere: r=1] }", "f.pha:1:4: Sphere needs a density"),
        ("{ [Sphere: r=1] rho=1 colour=3 }", "f.pha:1:23: 'colour' is not understood"),
        ("{ [Sphere: r=2e-2 & x=1] rho=1 }", "f.pha:1:19: '&' is not understood"),
        ("{ [Sphere: r=1/0] rho=1 }", "f.pha:1:15: division by zero"),
        ("{ [Cylinder: l=1 r=1] rho=1 }", "f.pha:1:4: Cylinder needs a direction axis(a, b, c)"),
        ("{ [Ellipt_Cyl: dx=1 dy=2 l=1 axis(0,0,1)] rho=1 }", "needs two of the directions a_x, a_y, axis"),
        ("{ [Ellipsoid_free: dx=1 dy=2 dz=1 a_x(1,0,0) a_y(1,1,0)] rho=1 }", "right-handed orthogonal frame"),
        ("#if 1\n", "f.pha:1:1: '#if 1' is not understood: only #define"),
        ('#include "none"\n', "none cannot be read as a FORBILD phantom: No such file"),
        ('#include "f.pha"\n', "files include each other"),
        ("#define M(a,b) a\n{ [Sphere: r=M(1)] rho=1 }", "f.pha:2:14: the macro M needs 2 arguments"),
        ("// nothing", "f.pha:1:1: there is no object in this file"),
    ],
)
def test_mistakes_are_one_sentence(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "f.pha").write_text(text, encoding="utf-8")
    with pytest.raises(SceneError) as caught:
        forbild_scene(tmp_path / "f.pha")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_command_writes_a_scene(tmp_path: Path) -> None:
    (tmp_path / "ball.pha").write_text("{ [Sphere: r=5] formula=H2O rho=1 }", encoding="utf-8")
    command = ["import", "forbild", str(tmp_path / "ball.pha"), "-o", str(tmp_path / "ball.yaml")]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    assert SceneFile.read(tmp_path / "ball.yaml").model.name == "ball"
    again = CliRunner().invoke(main, command)
    assert again.exit_code == 1
    assert "--overwrite" in again.output
