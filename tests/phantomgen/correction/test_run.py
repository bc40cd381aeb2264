"""Corrected scans against the effects that made them raw, and requests that cannot be met."""

import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main
from phantomgen.correction.run import Wanted, correct_file
from phantomgen.correction.sums import ScanSums
from phantomgen.dataset.reader import open_dataset
from phantomgen.effects.defects import Defects
from phantomgen.effects.pixel_gain import Gain
from phantomgen.effects.random_streams import Stream
from phantomgen.effects.tube_fluctuation import TubeOutput
from spectra.errors import InputError

VIEWS = 40
EFFECTS = (
    "effects={gain: {sigma: 0.03, drift: 0.01}, tube_output: {sigma: 0.02, recorded: false}, "
    "defects: {dead: 0.01, hot: 0.005, columns: [9], masked: false}}"
)


@pytest.fixture(scope="module")
def raw(tmp_path_factory):
    path = tmp_path_factory.mktemp("correct") / "raw.h5"
    return make(path, "--views", str(VIEWS), "--test-views", "0", "--set", EFFECTS, rows=40, columns=40)


def test_defects_drift_and_gains_of_a_scan(raw, tmp_path):
    found = correct_file(raw, tmp_path / "scan.h5")
    true = Defects(dead=0.01, hot=0.005, columns=(9,)).mask(0, 40, 40) > 0
    for mask in found.masks:
        assert not (true & (mask == 0)).any()
        assert np.count_nonzero(~true & (mask > 0)) <= 2
    output = TubeOutput(0.02, False)
    factors = output.factors(0, Stream.PROJECTION, VIEWS) / output.factors(0, Stream.FLAT, 50).mean()
    with open_dataset(raw) as before, open_dataset(tmp_path / "scan.h5") as after:
        assert (before.load() == after.load()).all()
        assert np.std(after.exposure[:, 0] / factors) < 1e-3
        changed = (after.flat / np.where(before.flat > 0, before.flat, 1))[:, ~true]
    gain = Gain(0.03, drift=0.01)
    views, flats = (gain.maps(0, 4, 40, 40, stream) for stream in (Stream.PROJECTION, Stream.FLAT))
    drift = (views / flats)[:, ~true]
    assert (drift / np.where(changed > 0, changed, 1)).std() < 0.98 * drift.std()
    alike = [np.corrcoef(one, other)[0, 1] for one, other in zip(changed, drift, strict=True)]
    assert min(alike) > 0  # the softest channel shows the object best, and its gains worst
    assert np.median(alike) > 0.3
    assert np.median([one.spread for one in found.gains]) == pytest.approx(0.01, rel=0.1)
    assert CliRunner().invoke(main, ["validate", str(tmp_path / "scan.h5")]).exit_code == 0


def test_steps_that_are_not_asked_for_are_left_out(raw, tmp_path):
    found = correct_file(raw, tmp_path / "scan.h5", Wanted(("defects",)))
    assert found.output is None
    assert found.gains == ()
    with open_dataset(raw) as before, open_dataset(tmp_path / "scan.h5") as after:
        assert (after.exposure == before.exposure).all()
        assert (after.flat == before.flat).all()
        assert after.mask.sum() > before.mask.sum()


def test_frames_of_files_replace_those_of_the_scan(raw, tmp_path):
    flats = np.full((2, 4, 40, 40), 5000, np.int32)
    np.save(tmp_path / "flats.npy", flats)
    out = tmp_path / "scan.h5"
    command = ["correct", str(raw), "-o", str(out), "--flats", str(tmp_path / "flats.npy"), "--steps", "defects"]
    result = CliRunner().invoke(main, command)
    assert result.exit_code == 0, result.output
    assert "flats: 2 frames that were given" in result.stdout
    with open_dataset(out) as dataset:
        assert dataset.counts.shape[0] == VIEWS
        assert (dataset.flat + dataset.dark == 5000).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--steps", "scatter"], "a correction is one of defects, drift, rings, got 'scatter'"),
        (["--flats", "none.npy"], "none.npy cannot be read"),
        (["--darks", "none.tif"], "there is no file none.tif"),
        (["--flats", "a.npy", "--flats", "b.npy"], "one .npy or a TIFF stack per channel"),
    ],
)
def test_bad_requests_are_one_sentence_and_write_nothing(raw, tmp_path, arguments, words):
    result = CliRunner().invoke(main, ["correct", str(raw), "-o", str(tmp_path / "scan.h5"), *arguments])
    assert words in one_sentence(result)
    assert list(tmp_path.iterdir()) == []


def test_frames_of_another_panel_are_refused(raw, tmp_path):
    with pytest.raises(InputError, match=r"flats have shape \(1, 4, 3, 3\)"):
        correct_file(raw, tmp_path / "scan.h5", Wanted(flats=np.ones((1, 4, 3, 3), np.int32)))
    with pytest.raises(InputError, match="is the scan itself"):
        correct_file(raw, raw)


def test_the_bar_moves_by_each_view_of_both_passes(raw):
    seen = []
    with open_dataset(raw) as dataset:
        sums = ScanSums(dataset, lambda: seen.append(1))
        sums.statistics()
        sums.blocks_and_runs(~dataset.mask)
        assert len(seen) == 2 * dataset.counts.shape[0]


def test_a_bar_changes_nothing(raw, tmp_path):
    plain, shown = (correct_file(raw, tmp_path / f"{bar}.h5", progress=bar) for bar in (False, True))
    assert plain.done == shown.done
