"""A static scene with a flat panel imports no module of what it does not have."""

import subprocess
import sys

import pytest

SCENE = (
    "kedge-small",
    {"geometry.views": 8, "geometry.test_views": 2, "panel": {"rows": 24, "columns": 24, "pitch": 6}},
)
MAKE = f"import phantomgen; phantomgen.make(phantomgen.load(*{SCENE!r}), out='scan.h5').close()"
FIT = (
    "from click.testing import CliRunner; from recon.cli.main import main; "
    "result = CliRunner().invoke(main, ['fit', 'scan.h5', '--sweeps', '0.1', '--no-figures', '-q']); "
    "assert result.exit_code == 0, result.output"
)
UNUSED = {
    "make": (
        "phantomgen.scene.dynamics",
        "phantomgen.scene.bodies.torso",
        "phantomgen.scene.bodies.head",
        "phantomgen.dataset.time.true_phases",
        "phantomgen.simulation.forward_model.scatter",
        "phantomgen.simulation.forward_model.view_times",
        "phantomgen.degradation.run",
        "phantomgen.dose",
    ),
    "fit": (
        "recon.phases",
        "recon.scatter.estimate",
        "recon.scatter.compton",
        "recon.calibration.perturbation",
        "recon.gaussians.on_curve.directions",
        "recon.gaussians.residual.fit_residual",
        "recon.published_methods.splatting",
        "recon.voxel.one_channel",
    ),
}


def run(code, folder):
    return subprocess.run([sys.executable, "-c", code], cwd=folder, check=True, capture_output=True, text=True).stdout


@pytest.fixture(scope="module")
def imported(tmp_path_factory):
    """Modules that a simulation and a fit import."""
    folder = tmp_path_factory.mktemp("static")
    listed = "import sys; print(*(m for m in sys.modules if m.startswith(('phantomgen', 'recon'))))"
    return {name: run(f"{code}; {listed}", folder).split() for name, code in (("make", MAKE), ("fit", FIT))}


@pytest.mark.parametrize(("what", "module"), [(what, module) for what, modules in UNUSED.items() for module in modules])
def test_what_a_scene_does_not_have_is_not_imported(imported, what, module):
    assert not [name for name in imported[what] if name == module or name.startswith(f"{module}.")]


def test_the_list_names_modules_that_exist():
    code = f"import importlib.util as u; assert all(map(u.find_spec, {[m for ms in UNUSED.values() for m in ms]!r}))"
    run(code, ".")
