"""This program against its peers, on the same scenes, views and machine: time per view, and error, side by side.

    python -m benchmarks.peers.simulators --peers-python /path/to/python

The peers (RTK, gVXR, Embree, Open3D) run in processes of their own, with the Python that has them; who cannot run is
listed with the reason. What to install is in `engines.py`. Errors are those of line integrals against float64
closed forms that share no code with us (`truth.py`), at the rays that a program itself says it takes. Times are
wall times of 8 views (2 for RTK's 1001 solids) divided by their number, from solids, meshes or voxels to an array of
line integrals; programs take turns, as often as --rounds says, with as many threads each. Prints, and writes to
results/peers.txt beside this file.
"""

import argparse
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from multiprocessing.connection import Listener
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.scenes import (
    BALL,
    PITCH,
    SIDE,
    VIEWS,
    Case,
    circle,
    foam,
    four,
    hard_cases,
    mesh_case,
    meshed,
    octasphere,
    prism,
)
from benchmarks.peers.truth import truth
from phantomgen.geometry.voxel_grid import Grid
from phantomgen.ops.mesh import Surfaces, cpu, mesh_view
from phantomgen.ops.primitives import BALL as OUR_BALL
from phantomgen.ops.primitives import CYLINDER as OUR_CYLINDER
from phantomgen.ops.project import project, values_of_averages
from phantomgen.ops.solids import Solids
from phantomgen.ops.trace import trace_view
from phantomgen.ops.voxel_maps import VoxelMap
from phantomgen.ops.voxelize_shapes import fractions
from phantomgen.shapes import Mesh, Voxels, solids_of
from spectra.threads import run_parallel, set_threads

PASSED = 1e-5  # relative error of single precision, roughly: what a hard case must reach


class Ours:
    """This program behind the interface of `engines`."""

    version = "ours"

    def load(self, case: Case) -> None:
        self.case = case
        side = case.side
        if case.volume is not None:
            grid = Grid.cube(len(case.volume), len(case.volume) * case.spacing)
            self.images = lambda: project(values_of_averages(case.volume)[None], grid, case.frames, side, side)[0]
        elif len(case.meshes) == 1:
            self.images = self._of_mesh(case)
        else:
            solids = our_solids(case)
            mu = np.array([[s.mu] for s in case.solids or case.meshes])
            mu, solids = merged(mu, solids)

            def view(frame: np.ndarray) -> np.ndarray:
                return trace_view(frame, side, side, solids, len(mu)) @ mu[:, 0]

            self.images = lambda: np.array(list(run_parallel(view, case.frames)))

    def _of_mesh(self, case: Case):
        surfaces = Surfaces.of([(case.meshes[0].vertices, case.meshes[0].triangles)])
        at = np.arange(case.side**2)
        uv = np.stack([at % case.side, at // case.side], axis=1).astype(np.float64)

        def view(frame: np.ndarray) -> np.ndarray:
            seen = mesh_view(frame, case.side, case.side, surfaces, with_outline=False)
            norms = case.meshes[0].mu * np.linalg.norm(frame[1] + uv @ frame[2:], axis=1)
            out = np.empty(len(uv))
            cpu.ray_lengths(*seen[:2], seen.starts[0], seen.candidates, uv, norms, at, np.empty(seen.room), out)
            return out.reshape(case.side, case.side)

        return lambda: np.array(list(run_parallel(view, case.frames)))

    def frames(self) -> np.ndarray:
        return self.case.frames

    def run(self) -> tuple[float, np.ndarray]:
        begin = time.perf_counter()
        images = self.images()
        return (time.perf_counter() - begin) / len(images), images


def our_solids(case: Case) -> Solids:
    """The objects of a case as ours, each of a material of its own."""
    if case.meshes:
        return solids_of([(Mesh(mesh.vertices, mesh.triangles), i) for i, mesh in enumerate(case.meshes)])
    inverse = np.linalg.inv([s.axes for s in case.solids])
    shift = -inverse @ np.array([s.center for s in case.solids])[:, :, None]
    kinds = np.array([OUR_BALL if s.kind == BALL else OUR_CYLINDER for s in case.solids])
    return Solids.plain(kinds, np.concatenate([inverse, shift], axis=2), np.arange(len(kinds)))


def merged(mu: np.ndarray, solids: Solids) -> tuple[np.ndarray, Solids]:
    """As few materials as there are values of mu."""
    values, which = np.unique(mu, return_inverse=True)
    return values[:, None], solids._replace(materials=which.reshape(-1)[solids.materials])


class Boxes(Ours):
    """This program where voxels are boxes, as the maps of scenes are: rays are cut at all faces."""

    version = "ours, voxels as boxes"

    def load(self, case: Case) -> None:
        self.case, most = case, float(case.volume.max())
        shape = Voxels(VoxelMap.of_fractions(case.volume[None] / most), np.eye(3) * case.spacing * 64, np.zeros(3))
        solids = solids_of([(shape, (0,))])

        def view(frame: np.ndarray) -> np.ndarray:
            return most * trace_view(frame, case.side, case.side, solids, 1)[..., 0]

        self.images = lambda: np.array(list(run_parallel(view, case.frames)))


class Peer:
    """Another program in a process of its own."""

    def __init__(self, name: str, python: str, threads: int) -> None:
        self.arguments = name, python, threads
        env = {**os.environ, "OMP_NUM_THREADS": str(threads), "LP_NUM_THREADS": str(threads)}
        env.pop("PYTHONPATH", None)
        with tempfile.TemporaryDirectory() as folder, Listener(str(Path(folder) / "socket")) as door:
            script = Path(__file__).with_name("engines.py")
            call = [python, str(script), name, str(threads), str(door.address)]
            self.process = subprocess.Popen(call, env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            self.line = door.accept()
        state, self.version = self.line.recv()
        self.ready = state == "ready"
        self.version = self.version if self.ready else f"{name} {state}: {self.version}"

    def _ask(self, request: Case | None) -> Any:
        self.line.send(request)
        return self.line.recv()

    def load(self, case: Case) -> None:
        self.rays = self._ask(case)

    def frames(self) -> np.ndarray:
        return self.rays

    def run(self) -> tuple[float, np.ndarray]:
        return self._ask(None)

    def close(self) -> None:
        self.line.close()
        self.process.wait()

    def restarted(self) -> "Peer":
        """The same program in a new process: gVXR's images depend on scenes that it had before."""
        self.close()
        return Peer(*self.arguments)


def errors(images: np.ndarray, case: Case, frames: np.ndarray, rays: int) -> tuple[float, float]:
    """Relative L2 error, and largest error over largest value, of some rays of the first two views."""
    pixels = np.stack(np.divmod(np.random.default_rng(0).permutation(case.side**2)[:rays], case.side), axis=1)
    wanted = known_truth(case, frames[:2], pixels)
    found = images[: len(wanted), pixels[:, 0], pixels[:, 1]]
    known = ~np.isnan(wanted)
    difference, wanted = (found - wanted)[known], wanted[known]
    scale = max(np.linalg.norm(wanted), 1e-300) if wanted.any() else np.sqrt(wanted.size)
    return float(np.linalg.norm(difference) / scale), float(abs(difference).max() / (abs(wanted).max() or 1.0))


def known_truth(case: Case, frames: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    """Truth of pixels (row, column) of some views, computed once for all programs that take the same rays."""
    key = (id(case), frames.tobytes(), len(pixels))
    if key not in _KNOWN:
        _KNOWN[key] = case, np.array([truth(case, frame, pixels) for frame in frames])
    return _KNOWN[key][1]


_KNOWN: dict[tuple[int, bytes, int], tuple[Case, np.ndarray]] = {}  # with the case, so that its id stays its own


def row(case: Case, engines: Sequence[Any], rounds: int, rays: int, truths: Sequence[Case] = ()) -> list[str]:
    """Lines of one case; errors against other cases, in other columns, if `truths` are given."""
    times: list[list[float]] = [[] for _ in engines]
    for engine in engines:
        engine.load(
            case if len(case.solids) < 500 or isinstance(engine, Ours) else replace(case, frames=case.frames[:2])
        )
        engine.run()
    for _ in range(rounds):
        for engine, found in zip(engines, times, strict=True):
            found.append(1e3 * engine.run()[0])
    lines = []
    for engine, found in zip(engines, times, strict=True):
        images = engine.run()[1]
        both = [errors(images, case, engine.frames(), rays) for case in (truths or (case,))]
        numbers = "".join(f"  {relative:8.1e} {worst:8.1e}" for relative, worst in both)
        ratio = min(found) / min(times[0])
        name = engine.version if isinstance(engine, Ours) else engine.version.split(",")[0]
        lines.append(f"{case.name:<18} {name:<28} {min(found):8.2f} {np.median(found):8.2f} {ratio:7.1f}{numbers}")
        print(lines[-1], flush=True)
    return lines


def verdicts(engines: dict[str, Any]) -> list[str]:
    """One line per hard case: the relative error of each program; the first case is easy."""
    lines = ["", f"hard cases: relative L2 error; * fails: above {PASSED:.0e} and 3 times one ball; - not applicable"]
    columns = [("solids", name) for name in ("ours", "RTK")]
    columns += [("mesh", name) for name in ("ours", "gVXR", "Embree", "Open3D")]
    lines.append(f"{'':<24}" + "".join(f"{name + ', ' + kind:>16}" for kind, name in columns))
    print("\n".join(lines))
    easy = dict.fromkeys(columns, 0.0)
    for i, case in enumerate(hard_cases()):
        cells = []
        for kind, name in columns:
            one, alone = meshed(case) if kind == "mesh" else case, name in {"Embree", "Open3D"}
            if name not in engines or (alone and len(one.meshes) > 1):
                cells.append("- ")
                continue
            if name == "gVXR":
                engines[name] = engines[name].restarted()
            engine = engines[name]
            engine.load(one)
            error = errors(engine.run()[1], one, engine.frames(), one.side**2)[0]
            easy[kind, name] = error if i == 0 else easy[kind, name]
            cells.append(f"{error:.0e}{' ' if error <= max(PASSED, 3 * easy[kind, name]) else '*'}")
        lines.append(f"{case.name:<24}" + "".join(f"{cell:>16}" for cell in cells))
        print(lines[-1], flush=True)
    return lines


def voxel_cases(scene: Case) -> tuple[Case, Case]:
    """The scene in 128^3 voxels by volume fractions, and the scene itself."""
    size, grid = 108.0, Grid.cube(128, 108.0)
    parts = fractions(grid, our_solids(scene), len(scene.solids))
    volume = np.tensordot([s.mu for s in scene.solids], parts, 1).astype(np.float32)
    return replace(scene, name="128^3 voxels", solids=(), volume=volume, spacing=size / 128), scene


def truths_of(scene: Case, voxels: Case) -> tuple[Case, Case, Case]:
    """The scene for the ray through the centre of each pixel, its mean over 4 x 4 rays, and the voxels themselves."""
    return scene, replace(scene, mean_of=4), voxels


def main() -> None:
    parser = argparse.ArgumentParser(description="This program and its peers: time per view, and error.")
    parser.add_argument("--peers-python", default=sys.executable, metavar="PATH", help="Python that has the peers")
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--rounds", type=int, default=9)
    asked = parser.parse_args()
    set_threads(asked.threads)
    load = os.getloadavg()[0]
    peers = {name: Peer(name, asked.peers_python, asked.threads) for name in ("RTK", "gVXR", "Embree", "Open3D")}
    engines = {"ours": Ours()} | {name: peer for name, peer in peers.items() if peer.ready}
    lines = [f"python -m benchmarks.peers.simulators --threads {asked.threads} --rounds {asked.rounds}"]
    lines.append(f"{platform.machine()}, {load:.1f} processes busy before the start")
    lines += [peer.version for peer in peers.values()]
    lines.append(
        "\n256 x 256 pixels             ms per view: least   median  to ours   relative L2, worst over largest value"
    )
    print("\n".join(lines), flush=True)

    def turn(*names: str) -> list[Any]:
        return [engines[name] for name in ("ours", *names) if name in engines]

    for case in (four(), foam(100, 6.0), foam(1000, 3.2)):
        lines += row(case, turn("RTK"), asked.rounds, 256**2)
    voxels, scene = voxel_cases(four())
    lines.append(
        "\nerrors against what was voxelized: central ray, mean over pixel; then against Siddon's paths through voxels"
    )
    print(lines[-1])
    for name, side, pitch in (("128^3 voxels", SIDE, PITCH), ("  2 mm pixels", SIDE // 2, 2 * PITCH)):
        seen = {"frames": circle(VIEWS, side, pitch), "side": side}
        case = replace(voxels, name=name, **seen)
        engines_here = [*turn("RTK"), Boxes()]
        lines += row(case, engines_here, asked.rounds, side**2, truths_of(replace(scene, **seen), case))
    lines.append("")
    for mesh in (prism(32, 40.0, 80.0), octasphere(47, 50.0), octasphere(183, 50.0)):
        rays = min(4096, 10**8 // len(mesh[1]))  # all triangles are tried on each
        lines += row(mesh_case(*mesh), turn("gVXR", "Embree", "Open3D"), asked.rounds, rays)
    lines += verdicts(engines)
    for name, peer in peers.items():
        engines.get(name, peer).close()
    (Path(__file__).parents[1] / "results" / "peers.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
