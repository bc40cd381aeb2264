"""Phases of a small scan: closer to the truth than all views together, what the run writes, and what is refused."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import torch
from click.testing import CliRunner
from PIL import Image

from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.time.true_phases import read_phases
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.run import simulate
from recon.cli.main import main
from recon.gaussians.divided.model_file import load_model
from recon.phases import alone
from recon.phases.run import divide
from recon.runs.run_folder import MODEL
from spectra.errors import InputError

SCENE = """\
version: 1
name: inflow
source: {type: tube, kvp: 120, anode: tungsten, angle: 12, filters: [{composition: Al, thickness: 5}], photons: 1.0e6}
detector: {type: photon_counting, thresholds: [20, 33.2, 50, 70]}
geometry: {type: circular, sod: 300, sdd: 450, views: 96, arc: 1425, test_views: 4}
panel: {rows: 24, columns: 40, pitch: 2}
volume: {voxels: 24, size: 48}
time:
  duration: 16
  phases: {count: 4}
  signals:
    bolus: {type: gamma_variate, arrival: 3, rise: 4}
    breath: {type: respiratory, period: 4}
materials:
  vessel_rest: {composition: water}
  peak: {solution: {solvent: water, solutes: {I: 20}}}
  vessel: {inflow: {rest: vessel_rest, peak: peak, signal: bolus}}
objects:
  - {type: cylinder, material: water, radius: 19, length: 24}
  - {type: cylinder, material: vessel, center: [8, 0, 0], radius: 5, length: 24}
"""


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    path = tmp_path_factory.mktemp("phases") / "inflow.h5"
    simulate(load_scene(SceneFile("inflow.yaml", SCENE)), path)
    return path


@pytest.mark.slow
def test_phases_are_closer_to_the_truth_than_all_views_together(scan, tmp_path):
    run = tmp_path / "run"
    shown = CliRunner().invoke(
        main, ["fit", str(scan), "--phases", "auto", "-o", str(run), "-q"], catch_exceptions=False
    )
    assert shown.exit_code == 0, shown.output
    scores = json.loads((run / "phases.json").read_text())
    assert (scores["phases"], scores["views"], scores["cyclic"]) == (4, [24] * 4, False)
    found, static = (np.array(scores["psnr"][how]["kedge_I"]) for how in ("phases", "static"))
    assert found.mean() > static.mean() + 3
    assert (found > static).all()
    assert "phase 3" in shown.output
    assert set(scores["alone"]) <= set("0123")
    assert all(0 < weight <= 1 for weight in scores["alone"].values())
    with h5py.File(run / "phases.h5") as file:
        volumes, stored = file["phases/data"][:], file["gaussians"]
        parts = {name: torch.from_numpy(part[()]) for name, part in stored.items() if isinstance(part, h5py.Dataset)}
        width = float(stored.attrs["width"])
        alone, weight = {}, 0.0
        if own := stored.get("phase_3"):
            alone = {name: torch.from_numpy(part[()]) for name, part in own.items()}
            weight, alone_width = float(own.attrs["weight"]), float(own.attrs["width"])
    moved = {"centres": parts["centres"] + parts["displacements"][3], "coefficients": parts["coefficients"][3]}
    shapes = {name: parts[name] for name in ("log_scales", "quaternions", "offsets")}
    model = load_model(run / MODEL)
    with open_dataset(scan) as dataset:
        last = replace(model, width=width, **shapes, **moved).volume(dataset.grid)
        if weight:
            last += weight * (replace(model, width=alone_width, **alone).volume(dataset.grid) - last)
        np.testing.assert_allclose(last, volumes[3], atol=1e-6)
    true = read_phases(scan)
    inside = np.s_[:, 2, 8:16, 11:13, 15:17]  # in the vessel
    found, wanted = (phases[inside].mean(axis=(1, 2, 3)) for phases in (volumes, true))
    assert np.abs(found - wanted).max() < 0.15 * true[:, 2].max()
    with Image.open(run / "figures" / "phases.gif") as film:
        assert film.n_frames == 4
    assert (run / "figures" / "phases.png").is_file()


def test_views_are_divided_as_stated_or_as_asked(scan):
    with open_dataset(scan) as dataset:
        stated, halves, breath = (divide(dataset, asked) for asked in ("auto", "2", "2:breath"))
    assert stated.phase.tolist() == [view // 24 for view in range(96)]
    assert (stated.stated, stated.cyclic) == (True, False)
    assert np.bincount(halves.phase).tolist() == [48, 48]
    assert not halves.stated
    assert breath.cyclic
    assert breath.phase[:24].tolist() == [0] * 6 + [1] * 12 + [0] * 6


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ("1", "a number from 2 to 100, with :CYCLE if any, got '1'"),
        ("x", "got 'x'"),
        ("4:heart", "there is no cycle 'heart': choose from breath"),
        ("99", "hold no training view, the first is phase"),
    ],
)
def test_divisions_that_cannot_be_are_refused(scan, asked, words):
    with open_dataset(scan) as dataset, pytest.raises(InputError, match=words):
        divide(dataset, asked)


def test_a_scan_without_times_is_refused_before_any_work(tmp_path):
    text = SCENE[: SCENE.index("time:")] + SCENE[SCENE.index("materials:") :].replace(
        "{inflow: {rest: vessel_rest, peak: peak, signal: bolus}}", "{composition: water}"
    )
    path = tmp_path / "rest.h5"
    few = ("geometry.views=8", "panel.rows=4", "flats=1")
    simulate(load_scene(SceneFile("rest.yaml", text, few)), path)
    shown = CliRunner().invoke(main, ["fit", str(path), "--phases", "4"])
    assert shown.exit_code == 1
    assert "states no times of its views: --phases needs a scan with /entry/time" in shown.output
    assert not (tmp_path / "rest-run").exists()


@pytest.mark.slow
def test_an_interrupted_run_goes_on_after_the_last_phase(scan, tmp_path, monkeypatch):
    fitted, real = [], alone.reconstruct

    def counted(dataset, recipe):
        fitted.append(len(fitted))
        if len(fitted) == 3:
            raise KeyboardInterrupt
        return real(dataset, recipe)

    def fit(name, *more):
        arguments = ["fit", str(scan), "--phases", "auto", "-o", str(tmp_path / name), "--sweeps", "0.3", "-q"]
        return CliRunner().invoke(main, [*arguments, "--no-figures", *more])

    monkeypatch.setattr(alone, "reconstruct", counted)
    assert fit("run").exit_code != 0
    assert fit("run", "--resume").exit_code == 0
    assert len(fitted) == 3 + 2
    monkeypatch.setattr(alone, "reconstruct", real)
    assert fit("whole").exit_code == 0
    assert {p.name for p in (tmp_path / "run").iterdir()} == {p.name for p in (tmp_path / "whole").iterdir()}
    for name in ("phases.h5", "model.safetensors"):
        assert (tmp_path / "run" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
