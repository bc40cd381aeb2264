"""The definition of a suite: cases, tiers, and the scene of a case in a tier."""

import json
from dataclasses import dataclass
from hashlib import sha256
from importlib import resources
from math import ceil
from typing import Any

import yaml

from phantomgen.degradation.settings import Degradation
from phantomgen.scene.file.scene_file import SceneFile
from spectra.errors import InputError

_FOLDER = resources.files("phantomgen.suite") / "definitions"


@dataclass(frozen=True)
class Case:
    """One scan of a suite.

    Parameters
    ----------
    name, what : its name, and what it is in words
    scene : the scene with all overrides of the tier
    degradation : what is made worse afterwards; None for nothing
    sha256 : digest of the values of the scene and of what is made worse
    """

    name: str
    what: str
    scene: SceneFile
    degradation: Degradation | None
    sha256: str


@dataclass(frozen=True)
class Suite:
    """A suite in one tier.

    Parameters
    ----------
    name, tier : which one
    sha256 : digest of the scenes of all cases in the tier; with name and tier, what results cite
    seconds : time that each method gets on each case where nothing else is asked for [s]
    cases : the scans
    expected : what was stored for the cases of the tier by name; empty where nothing is
    """

    name: str
    tier: str
    sha256: str
    seconds: float
    cases: tuple[Case, ...]
    expected: dict[str, Any]


def suite_names() -> tuple[str, ...]:
    """List the suites that the program knows.

    Returns
    -------
    their names
    """
    return tuple(sorted(path.name.removesuffix(".yaml") for path in _FOLDER.iterdir() if path.name.endswith(".yaml")))


def read_suite(name: str, tier: str) -> Suite:
    """Read a suite.

    Parameters
    ----------
    name : such as ``v1``
    tier : ``minutes``, ``hour`` or ``night``

    Returns
    -------
    the suite

    Raises
    ------
    InputError
        When there is no such suite or tier.
    """
    if name not in suite_names():
        raise InputError(f"there is no suite {name!r}: choose from {', '.join(suite_names())}")
    content = yaml.safe_load((_FOLDER / f"{name}.yaml").read_text(encoding="utf-8"))
    if tier not in content["tiers"]:
        raise InputError(f"the suite {name} has no tier {tier!r}: choose from {', '.join(content['tiers'])}")
    size = content["tiers"][tier]
    scale = size["voxels"] / content["base_voxels"]
    cases = tuple(_case(entry, content, scale) for entry in content["cases"])
    stored = _FOLDER / f"{name}-expected.json"
    expected = json.loads(stored.read_text(encoding="utf-8")) if stored.is_file() else {}
    digest = _digest([name, tier, [[case.name, case.sha256] for case in cases]])
    return Suite(name, tier, digest, size["seconds"], cases, expected.get(tier, {}))


def _case(entry: dict[str, Any], content: dict[str, Any], scale: float) -> Case:
    """One case with fewer voxels, pixels and views."""
    whole = _scene(entry, ())
    panel = whole.values["panel"]
    values = {
        "geometry.views": round(entry["views"] * scale),
        "geometry.test_views": content["test_views"],
        "volume.voxels": round(content["base_voxels"] * scale),
        "panel.rows": ceil(panel["rows"] * scale),
        "panel.columns": ceil(panel["columns"] * scale),
        "panel.pitch": panel["pitch"] / scale,
        "seed": entry["seed"],
        **entry.get("set", {}),
    }
    overrides = tuple(f"{path}={value}" for path, value in values.items())
    worse = entry.get("degrade")
    scene = _scene(entry, overrides)
    return Case(
        entry["name"],
        entry["what"],
        scene,
        None if worse is None else Degradation(**worse, seed=entry["seed"]),
        _digest([scene.values, worse]),
    )


def _digest(values: Any) -> str:
    """SHA-256 of values, which comments and the order of keys do not change."""
    return sha256(json.dumps(values, sort_keys=True).encode()).hexdigest()


def _scene(entry: dict[str, Any], overrides: tuple[str, ...]) -> SceneFile:
    """Scene of a case: a preset, or a text of its own."""
    if "preset" in entry:
        return SceneFile.preset(entry["preset"], overrides)
    return SceneFile(f"{entry['name']}.yaml", entry["scene"], overrides)
