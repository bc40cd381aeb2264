"""``phantomgen degrade``: what it prints, and how it ends."""

import json

import pytest
from click.testing import CliRunner
from support.tiny_scans import make, one_sentence

from phantomgen.cli.main import main
from phantomgen.dataset.reader import open_dataset


def run(*arguments: object):
    return CliRunner().invoke(main, ["degrade", *map(str, arguments)])


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("degrade") / "scan.h5", "--views", "8", "--test-views", "2")


def test_all_options_and_what_is_said(scan, tmp_path):
    out = tmp_path / "low.h5"
    wish = "--dose 0.25 --views 4 --arc 0:200 --truncate 25% --bin 2 --dead 1% --shift 0.5px --tilt 0.3 --kv-error 2"
    result = run(scan, "-o", out, *wish.split())
    assert result.exit_code == 0, result.output
    first, *phrases = result.stdout.splitlines()
    assert first == f"{out}: 6 views x 4 channels x 16 x 12"
    assert phrases[:2] == [
        "  dose 0.25: binomial thinning of counts; flats as measured, exposure scaled",
        "  views: 4 of 8 training views from 0 to 200 degrees; 2 test kept",
    ]
    info = CliRunner().invoke(main, ["info", str(out)])
    assert (
        "degraded   panel: 4 of 32 columns cut off on each side, 2 x 2 pixels summed, 2 pixels made dead" in info.stdout
    )


def test_levels_are_files_of_their_own(scan, tmp_path):
    result = run(scan, "-o", tmp_path / "pairs.h5", "--levels", "1,0.5,0.25", "--json")
    assert result.exit_code == 0, result.output
    assert [one["file"] for one in json.loads(result.stdout)] == [
        str(tmp_path / f"pairs-{level}.h5") for level in ("1", "0.5", "0.25")
    ]
    sums = []
    for level in ("1", "0.5", "0.25"):
        with open_dataset(tmp_path / f"pairs-{level}.h5") as dataset:
            sums.append(dataset.load().sum())
    with open_dataset(scan) as dataset:
        assert sums[0] == dataset.load().sum()
    assert [total / sums[0] for total in sums] == pytest.approx([1, 0.5, 0.25], rel=1e-3)
    alone = run(scan, "-o", tmp_path / "alone.h5", "--dose", "0.25")
    assert alone.exit_code == 0
    with open_dataset(tmp_path / "alone.h5") as one, open_dataset(tmp_path / "pairs-0.25.h5") as other:
        assert (one.load() == other.load()).all()


def test_an_existing_level_is_refused_before_any_work(scan, tmp_path):
    (tmp_path / "pairs-0.5.h5").write_text("mine")
    result = run(scan, "-o", tmp_path / "pairs.h5", "--levels", "1,0.5")
    assert "pairs-0.5.h5 exists" in one_sentence(result)
    assert [path.name for path in tmp_path.iterdir()] == ["pairs-0.5.h5"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "nothing is to be changed"),
        (["--levels", "0.5", "--dose", "0.5"], "--levels names the doses"),
        (["--levels", "0.5,0.5"], "no list of different doses"),
        (["--levels", "half"], "no list of different doses"),
        (["--arc", "a:b"], "neither an angle"),
        (["--truncate", "much"], "neither a percentage"),
        (["--shift", "1mm"], "no number of pixels"),
    ],
)
def test_wrong_usage_ends_with_2(scan, tmp_path, arguments, words):
    result = run(scan, "-o", tmp_path / "low.h5", *arguments)
    assert result.exit_code == 2
    assert words in result.stderr


def test_the_name_of_the_output_is_that_of_a_dataset(scan, tmp_path):
    assert "is an HDF5 file" in one_sentence(run(scan, "-o", tmp_path / "low", "--dose", "0.5"))


def test_a_report_tells_what_was_done(scan, tmp_path):
    assert run(scan, "-o", tmp_path / "low.h5", "--dose", "0.25", "--bin", "2").exit_code == 0
    result = CliRunner().invoke(main, ["report", str(tmp_path / "low.h5"), "-o", str(tmp_path / "low.html")])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "low.html").read_text(encoding="utf-8")
    assert "exposure scaled; panel: 2 x 2 pixels summed" in page
