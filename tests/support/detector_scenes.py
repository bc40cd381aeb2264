"""Small scans of one sphere by detectors that count photons, and by such that integrate energy."""

import numpy as np

from phantomgen.effects.random_streams import Stream
from phantomgen.scene.file.scene_file import SceneFile
from phantomgen.scene.scan import load_scene
from phantomgen.simulation.forward_model.exposure import Exposure
from phantomgen.simulation.forward_model.frames import Views
from phantomgen.simulation.forward_model.sampled_rays import sampled_lengths

SCENE = """\
version: 1
name: toy
source: {type: lines, lines: {40: 1, 60: 1, 80: 1}, photons: 3000}
detector: {type: photon_counting, thresholds: [25, 50, 70]}
geometry: {type: circular, sod: 500, sdd: 800, views: 3}
panel: {rows: 40, columns: 48, pitch: 1.0}
volume: {voxels: 4, size: 40}
materials:
  water: {composition: H2O, density: 1.0}
objects:
  - {type: sphere, material: water, radius: 8}
flats: 4
"""


def counting(*overrides):
    return load_scene(SceneFile("toy.yaml", SCENE, overrides))


def integrating(*overrides):
    return counting("detector={type: energy_integrating}", *overrides)


def views_of(scan):
    return Views(scan, Exposure.of(scan, sampled_lengths(scan), 1e-5)[0])


def frames(views, stream, count, noise=None):
    """Readings of several frames, (frame, channel, row, column); no afterglow."""
    panel, channels, read = views.scan.geometry.panel, len(views.scan.detector), []
    for frame in range(count):
        if stream is Stream.DARK:
            signals = list(np.zeros((channels, panel.rows, panel.columns)))
        else:
            signals = views.registered(views.expected(frame, stream), frame, stream, noise)
        read.append(views.read(signals, frame, stream, noise))
    return np.array(read, dtype=np.float64)


def flats(scan, count=4, noise=None):
    return frames(views_of(scan), Stream.FLAT, count, noise)
