"""Copies of datasets with corrected statements: what changes, what stays, and that they are whole."""

import numpy as np
import pytest
from click.testing import CliRunner
from support.tiny_scans import make

from phantomgen.cli.main import main
from phantomgen.dataset.file import DARK, FLAT
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.true_poses import read_true_geometry
from phantomgen.dataset.writing.corrected_copy import CorrectedCopy
from phantomgen.geometry.panel_changes import moved_panel
from spectra.errors import InputError


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("copy") / "scan.h5", "--views", "6", "--test-views", "2", rows=8, columns=8)


def test_statements_change_and_counts_stay(scan, tmp_path):
    out = tmp_path / "copy.h5"
    with open_dataset(scan) as dataset, CorrectedCopy(scan, out) as copy:
        moved = moved_panel(dataset.geometry, 0.5, 0.2, down=0.25)
        copy.replace_geometry(dataset.geometry, moved)
        copy.replace_exposure(np.full((8, 4), 0.5))
        mask = np.zeros((8, 8), np.uint32)
        mask[2, 3] = 2
        copy.replace_mask("bin1", mask)
        copy.replace_mask("bin1", mask)
        copy.replace_frames(FLAT, np.full((3, 4, 8, 8), 1000, np.int32), "counts")
        copy.replace_frames(DARK, np.zeros((1, 4, 8, 8), np.int32), "counts")
        copy.write_history("phantomgen correct", ["flats: new ones"], {"why": "test"})
        copy.finish(dataset.spectra)
    with open_dataset(scan) as before, open_dataset(out) as after:
        assert (before.load() == after.load()).all()
        assert after.geometry == moved
        assert (after.exposure == 0.5).all()
        assert after.mask.sum() == 1
        assert after.mask[1, 2, 3]
        assert (after.flat == 1000).all()
        assert read_true_geometry(out) == before.geometry
    assert CliRunner().invoke(main, ["validate", str(out)]).exit_code == 0
    assert "corrected  flats: new ones" in CliRunner().invoke(main, ["info", str(out)]).stdout


def test_true_poses_are_those_of_the_first_file_after_two_corrections(scan, tmp_path):
    with open_dataset(scan) as dataset:
        true, spectra = dataset.geometry, dataset.spectra
    for number, source in ((1, scan), (2, tmp_path / "1.h5")):
        with open_dataset(source) as dataset, CorrectedCopy(source, tmp_path / f"{number}.h5") as copy:
            copy.replace_geometry(dataset.geometry, moved_panel(dataset.geometry, 1.0))
            copy.finish(spectra)
    assert read_true_geometry(tmp_path / "2.h5") == true


def test_nothing_is_left_of_a_copy_that_fails(scan, tmp_path):
    with pytest.raises(ZeroDivisionError), CorrectedCopy(scan, tmp_path / "copy.h5"):
        _ = 1 / 0
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="is the scan itself"):
        CorrectedCopy(scan, scan, overwrite=True)
