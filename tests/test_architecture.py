"""What the project promises about itself: who may import whom, how long a file may be, what a wheel holds."""

import ast
import dis
import doctest
import re
import shlex
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from importlib import import_module, metadata
from pathlib import Path

import click
import grimp
import pytest
from click.testing import CliRunner
from numba.core.dispatcher import Dispatcher
from packaging.requirements import Requirement

from phantomgen.cli.main import main as phantomgen
from recon.cli.main import main as recon

ROOT = Path(__file__).parents[1]
PACKAGES = ("spectra", "phantomgen", "recon")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]
PAGES = sorted(
    path.relative_to(ROOT).as_posix()
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
    if not {"outside", "_build"} & set(path.parts)  # made when the site is built
)
# Modules that come with a dependency: Triton with torch's builds for GPUs, which choose its version. And DeepInverse,
# which no other test needs.
BROUGHT_ALONG = {
    "xraylib_np": ["xraylib"],
    "llvmlite": ["numba"],
    "triton": ["torch"],
    "tifffile": ["scikit-image"],
    "deepinv": ["deepinv"],
}
PROGRAMS = {"phantomgen": phantomgen, "recon": recon}
# Scripts of folders that `phantomgen export` writes, and of R2-Gaussian.
ELSEWHERE = {"load.py", "initialize_pcd.py", "train.py"}


def files(*folders: str, suffix: str = "") -> list[Path]:
    found = (path for folder in folders for path in (ROOT / folder).rglob("*") if path.is_file())
    return [path for path in found if "__pycache__" not in path.parts and path.name.endswith(suffix)]


@pytest.fixture(scope="module")
def imports():
    return grimp.build_graph(*PACKAGES, include_external_packages=True, cache_dir=None)


def test_import_contracts_hold():
    program = "import sys; from importlinter.cli import lint_imports; sys.exit(lint_imports(no_cache=True))"
    command = [sys.executable, "-c", program]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, encoding="utf-8", check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    assert f"{len(PROJECT['tool']['importlinter']['contracts'])} kept, 0 broken" in result.stdout


def test_everything_imported_is_a_dependency(imports):
    known = {**metadata.packages_distributions(), **BROUGHT_ALONG}
    external = {name for name in imports.modules if name.partition(".")[0] not in {*PACKAGES, *sys.stdlib_module_names}}
    needed = {known[name.partition(".")[0]][0].lower() for name in external}
    extras = PROJECT["project"]["optional-dependencies"]
    optional = {
        Requirement(text).name.lower()
        for extra in ("cluster", "compress", "deepinv", "images", "io", "xarray")
        for text in extras[extra]
    }
    assert needed == {Requirement(text).name for text in PROJECT["project"]["dependencies"]} | optional


def test_tables_of_physics_and_files_of_meshes_have_one_door_each(imports):
    assert imports.find_modules_that_directly_import("xraylib") == {"spectra.elements.attenuation"}
    assert imports.find_modules_that_directly_import("spekpy") == {"spectra.source.tube"}
    assert imports.find_modules_that_directly_import("trimesh") == {"phantomgen.shapes.meshes.mesh"}
    both = {"phantomgen.volume_files.images", "phantomgen.exporters.dicom"}  # one reads, one writes
    assert imports.find_modules_that_directly_import("SimpleITK") == both


def folders_of_modules() -> dict[Path, set[str]]:
    """Folders of the packages, and the modules and folders in each."""
    found = {}
    for package in PACKAGES:
        for init in (ROOT / package).rglob("__init__.py"):
            modules = {path.stem for path in init.parent.glob("*.py")} - {"__init__", "__main__"}
            found[init.parent] = modules | {path.parent.name for path in init.parent.glob("*/__init__.py")}
    return found


def test_a_folder_holds_about_a_dozen_files_at_most():
    counts = {str(path.relative_to(ROOT)): len(list(path.glob("*.py"))) - 1 for path in folders_of_modules()}
    assert {folder: count for folder, count in counts.items() if count > 14} == {}


def test_every_module_has_a_layer_in_the_contract_of_its_folder():
    contracts = [c for c in PROJECT["tool"]["importlinter"]["contracts"] if "containers" in c]
    listed = {c["containers"][0]: {m.strip() for line in c["layers"] for m in line.split("|")} for c in contracts}
    for path, modules in folders_of_modules().items():
        name = ".".join(path.relative_to(ROOT).parts)
        if name in listed:
            assert modules == listed[name], name
        else:
            assert len(modules) <= 3, f"{name} has no contract"


def test_no_file_is_longer_than_600_lines():
    sources = files(*PACKAGES, "tests", "examples", "benchmarks", suffix=".py")
    lengths = {path.relative_to(ROOT): len(path.read_text(encoding="utf-8").splitlines()) for path in sources}
    assert {path: length for path, length in lengths.items() if length > 600} == {}


def parameters_of(function: ast.FunctionDef) -> int:
    a = function.args
    names = [argument.arg for argument in (*a.posonlyargs, *a.args, *a.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"]))


@pytest.mark.parametrize("package", ["spectra", "phantomgen"])
def test_no_function_takes_more_than_eight_arguments(package):
    """Commands take their options one by one, and Triton kernels sizes and strides as numbers."""
    long = []
    for path in files(package, suffix=".py"):
        for function in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef) and parameters_of(function) > 8:
                marks = " ".join(ast.unparse(mark) for mark in function.decorator_list)
                if "click" not in marks and "triton" not in marks:
                    long.append(f"{path.relative_to(ROOT)}: {function.name}")
    assert long == []


def test_a_wheel_holds_the_three_packages_and_nothing_else():
    patterns = SETUPTOOLS["packages"]["find"]["include"]
    visible = [folder.name for folder in ROOT.iterdir() if folder.is_dir() and not folder.name.startswith(".")]
    folders = {path.parent for path in files(*visible, suffix=".py")}
    packages = {".".join(path.relative_to(ROOT).parts) for path in folders}
    taken = {package for package in packages if any(fnmatch(package, pattern) for pattern in patterns)}
    assert {package.partition(".")[0] for package in taken} == set(PACKAGES)
    assert [path for path in map(ROOT.joinpath, PACKAGES) if not (path / "__init__.py").exists()] == []


def test_data_files_of_the_packages_are_in_the_wheel():
    data = [path for path in files(*PACKAGES) if path.suffix not in {".py", ".nbi", ".nbc"}]
    assert {path.name for path in data} >= {"kedge.yaml", "kedge-small.yaml", "py.typed"}
    for path in data:
        package, inside = path.relative_to(ROOT).parts[0], "/".join(path.relative_to(ROOT).parts[1:])
        assert any(fnmatch(inside, pattern) for pattern in SETUPTOOLS["package-data"][package]), path


def test_pinned_versions_cover_what_is_asked_for():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {Requirement(line).name.lower() for line in lines if line and not line.startswith("#")}
    extras = PROJECT["project"]["optional-dependencies"].values()
    asked = {
        Requirement(text).name.lower() for group in (PROJECT["project"]["dependencies"], *extras) for text in group
    }
    assert asked - pinned <= {PROJECT["project"]["name"], "triton"}


def commands(page: str) -> list[list[str]]:
    """Words of every line in the page's code blocks, comments and redirections left out."""
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^```(?:sh|bash|console)?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    lines = "".join(blocks).replace("\\\n", " ").splitlines()
    candidates = [
        line.removeprefix("$ ") for line in lines if re.match(r"(\$ )?(phantomgen|recon|make|python)\b", line)
    ]
    return [shlex.split(line.partition(">")[0], comments=True) for line in candidates]


def leaves(command: click.Command) -> list[click.Command]:
    return [command, *(leaf for child in getattr(command, "commands", {}).values() for leaf in leaves(child))]


@pytest.mark.parametrize("page", PAGES)
def test_commands_in_the_documentation_are_understood(page, monkeypatch):
    targets = re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    for command in leaves(phantomgen) + leaves(recon):
        monkeypatch.setattr(command, "callback", lambda *args, **kwargs: None)
    monkeypatch.setattr(
        "recon.cli.run_argument.RunFolder.convert", lambda self, value, *_: value
    )  # there are no runs here
    for program, *arguments in commands(page):
        if program == "make":
            assert set(arguments) <= set(targets), arguments
        elif program == "python" and arguments[0] != "-m":
            assert (ROOT / arguments[0]).is_file() or Path(arguments[0]).name in ELSEWHERE, arguments
        elif program in PROGRAMS:
            result = CliRunner().invoke(PROGRAMS[program], arguments)
            assert result.exit_code == 0, (arguments, result.output)


@pytest.mark.parametrize("page", PAGES)
def test_links_in_the_documentation_lead_to_files(page):
    folder = (ROOT / page).parent
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / page).read_text(encoding="utf-8"))
    made = "gallery/index"  # by the build of the site
    assert [link for link in links if "://" not in link and link != made and not (folder / link).exists()] == []


@pytest.mark.parametrize("page", [page for page in PAGES if ">>> " in (ROOT / page).read_text(encoding="utf-8")])
def test_examples_in_the_documentation_are_true(page):
    assert doctest.testfile(str(ROOT / page), module_relative=False, encoding="utf-8").failed == 0


def test_the_example_that_opens_the_package_is_true():
    import phantomgen as package

    assert doctest.testmod(package).failed == 0


def test_the_version_is_the_same_everywhere():
    version = PROJECT["project"]["version"]
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert f"## [{version}] - 20" in changes or f"release will be version {version}." in changes
    assert f"version: {version}" in (ROOT / "CITATION.cff").read_text(encoding="utf-8")


def test_nothing_but_kernels_for_gpus_needs_triton():
    # PyTorch's builds for the CPU, for macOS and for Windows bring none.
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in files(*PACKAGES, suffix=".py")
        if path.name not in {"gpu.py", "gpu_calls.py", "deepinv.py"} and path.parent.name != "gpu"
    ]
    assert len(modules) > 300
    code = f"import sys, importlib; sys.modules['triton'] = None; [importlib.import_module(m) for m in {modules}]"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def kernels():
    for path in files(*PACKAGES, suffix=".py"):
        if (
            path.name in {"gpu.py", "deepinv.py"} or path.parent.name == "gpu"
        ):  # no numba, and Triton and DeepInverse are not everywhere
            continue
        module = import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
        yield from ((module, name, value) for name, value in vars(module).items() if isinstance(value, Dispatcher))


def test_kernels_that_reorder_sums_are_not_called_but_inlined():
    # numba may run one copy of a called function when it compiles, another when it loads from its cache.
    called = {value for module, _, kernel in kernels() for value in used_by(module, kernel)}
    reordering = {kernel for kernel in called if kernel.targetoptions.get("fastmath")}
    assert len(reordering) >= 3
    for kernel in reordering:
        assert kernel.targetoptions.get("forceinline") or kernel.targetoptions.get("inline") == "always", kernel


def test_kernels_that_reorder_sums_call_nothing_that_takes_the_flags_of_who_comes_first():
    # numba compiles a function that names no flags, and the built-ins below, once in a process, with those of its first
    # caller. Then the last digits of a fit would depend on what was compiled before, and two installs would differ.
    parts = [(module, kernel) for module, _, kernel in kernels() if kernel.targetoptions.get("fastmath")]
    assert len(parts) >= 10
    for module, kernel in parts:  # grows
        instructions = list(dis.get_instructions(kernel.py_func))
        names = {i.argval for i in instructions if isinstance(i.argval, str)}
        assert not names & {"max", "min", "pow", "round", "sum", "divmod"}, kernel
        assert not [i for i in instructions if i.argrepr in {"**", "**="}], kernel
        for other in used_by(module, kernel):
            if other.targetoptions.get("inline") == "always":
                parts += [(sys.modules[other.py_func.__module__], other)]
            else:
                assert "fastmath" in other.targetoptions, (kernel, other)


def used_by(module, kernel):
    found = (getattr(module, name, None) for name in kernel.py_func.__code__.co_names)
    return [value for value in found if isinstance(value, Dispatcher)]
