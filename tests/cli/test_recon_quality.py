"""``recon quality``: d' of observers against the counts, the image noise and each other; what a user can do wrong."""

import json
import shutil

import numpy as np
import pytest
from click.testing import CliRunner

import recon as package
from phantomgen.dataset.reader import open_dataset
from phantomgen.dataset.truth import read_truth
from recon.cli.main import main as recon
from recon.detectability.classes import ideal_observer_square, true_volumes
from recon.detectability.image_quality import ImageQuality, stored_qualities
from recon.detectability.insert import Insert, WithoutInsert
from recon.output.report.case import Case
from recon.output.report.finished_run import open_finished_run
from recon.output.report.uncertainty import detectability_parts
from recon.uncertainty.estimate import RepeatableRun
from recon.uncertainty.replicate import Replicate
from recon.voxel.model import Voxels
from spectra.errors import InputError
from tests.support.tiny_scans import make, one_sentence

PAIRS = 6
VIALS = "22,-6,0,11,60"  # a cylinder of `kedge-small`
OF_VIALS = ("--insert", VIALS, "-n", PAIRS)
FEW = ("--set", "geometry.views=16", "--set", "geometry.test_views=2")


def call(*arguments):
    return CliRunner().invoke(recon, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("quality")
    make(place / "scan.h5", *FEW, voxels=32)
    result = call("fit", place / "scan.h5", "-o", place / "run", "--method", "fdk", "--no-figures", "-q")
    assert result.exit_code == 0, result.output
    return place


@pytest.fixture(scope="module")
def stated(folder):
    result = call("quality", folder / "run", *OF_VIALS, "--json")
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)


@pytest.mark.slow
def test_the_ideal_observer_knows_what_the_likelihood_ratio_of_the_counts_tells(folder):
    """For a weak signal d'^2 is the symmetrised Kullback-Leibler divergence of the counts (Barrett & Myers 13.2)."""
    with open_dataset(folder / "scan.h5") as dataset:
        run = RepeatableRun.of_run(folder / "run", dataset)
        model, names = run.stored.model, run.stored.model.basis_names
        weak = Voxels(0.1 * Insert.parse(VIALS).excess(model.volume(run.grid), run.grid), run.grid, names)
        without = WithoutInsert(model, weak)
        found = ideal_observer_square(run.dataset, model, without)
        views = run.dataset.splits["train"]
        present, absent = (
            np.mean([Replicate.of(run.dataset, each, seed, k).load(views) for k in range(40)], axis=0)
            for seed, each in enumerate((model, without))
        )
    dark = run.dataset.dark if np.ndim(run.dataset.dark) else float(run.dataset.dark)
    present, absent = present - dark, absent - dark
    noise = 2 * present.size / 40  # what the noise of the mean counts adds
    divergence = float(np.sum((present - absent) * np.log(present / absent)))
    assert divergence - noise == pytest.approx(found, rel=0.1)


def test_no_observer_of_images_exceeds_the_ideal_one(stated):
    ideal = stated["ideal"]
    for name in ("without_prewhitening", "hotelling"):
        one = stated[name]
        assert 0 < one["low"] < one["value"] < one["high"]
        assert one["low"] < ideal


def test_contrast_and_noise_are_those_of_regions_in_the_volumes(folder, stated):
    volume = np.asarray(package.readout(folder / "run", "hu"))
    with open_dataset(folder / "scan.h5") as dataset:
        grid = dataset.grid
    insert = Insert.parse(VIALS)
    inside, ring = insert.region(grid, 0.7), insert.region(grid, 2.0) & ~insert.region(grid, 1.5)
    assert stated["contrast"] == pytest.approx(volume[inside].mean() - volume[ring].mean(), rel=0.15)
    deviation = np.asarray(package.deviation(folder / "run", "hu"))
    assert stated["noise"] == pytest.approx(np.sqrt((deviation[inside] ** 2).mean()), rel=0.3)
    assert stated["contrast_to_noise"] == pytest.approx(stated["contrast"] / stated["noise"])
    power = np.array(stated["power"])
    assert (power > 0).all()


def test_reconstructions_are_kept_and_another_quantity_needs_no_new_ones(folder, stated):
    del stated
    kept = {path: path.stat().st_mtime_ns for path in (folder / "run").rglob("seed_*.h5")}
    assert len(kept) == 2 * PAIRS
    with open_dataset(folder / "scan.h5") as dataset:
        made = package.estimate_detectability(folder / "run", dataset, VIALS, "vmi", 60.0, pairs=PAIRS)
    assert {path: path.stat().st_mtime_ns for path in (folder / "run").rglob("seed_*.h5")} == kept
    assert made.unit == "1/mm"


def test_an_energy_that_is_no_number_is_refused(folder):
    result = call("quality", folder / "run", "--insert", VIALS, "--energy", "nan")
    assert result.exit_code == 2
    assert "nan is not a finite number" in result.stderr


def test_what_is_written_is_read_and_stands_in_the_report(folder, stated, tmp_path):
    (found,) = stored_qualities(folder / "run")
    assert isinstance(found, ImageQuality)
    assert found.hotelling.value == stated["hotelling"]["value"]
    assert found.images.shape[0] == 3
    assert (folder / "run" / "quality" / VIALS / "hounsfield_70_keV.png").is_file()
    run = open_finished_run(folder / "run")
    with open_dataset(folder / "scan.h5") as dataset:
        picture, table = detectability_parts(Case((run,), dataset, read_truth(dataset.path), tmp_path))
    assert (tmp_path / "quality.svg").is_file()
    assert f"of {PAIRS} each" in picture.caption
    assert table.rows[0][-1] == f"{stated['ideal']:.2f}"
    assert table.rows[0][2] == f"{stated['contrast']:.4g} HU"


@pytest.mark.slow
def test_counts_of_the_truth_have_the_contrast_of_the_scene(folder):
    result = call("quality", folder / "run", *OF_VIALS, "--truth", "--as", "vmi", "--json")
    assert result.exit_code == 0, result.output
    found = json.loads(result.stdout)
    assert found["quality"].endswith("attenuation_70_keV_of_truth.json")
    with open_dataset(folder / "scan.h5") as dataset:
        run = RepeatableRun.of_run(folder / "run", dataset)
        truth = true_volumes(read_truth(dataset.path), run.grid, run.stored.model.basis_names)
        without = WithoutInsert(
            truth, Voxels(Insert.parse(VIALS).excess(truth.values, run.grid), run.grid, truth.basis_names)
        )
        assert found["ideal"] == pytest.approx(np.sqrt(ideal_observer_square(run.dataset, truth, without)))
    bases = [0.0067 - 0.0015, 0.0180 - 0.0188, 0.0250]  # of the scene: vials minus soft tissue, 1/mm at 70 keV
    assert found["contrast"] == pytest.approx(sum(bases), rel=0.1)
    result = call(
        "fit", folder / "scan.h5", "-o", folder / "two", "--method", "fdk", "--bases", 2, "--no-figures", "-q"
    )
    assert result.exit_code == 0, result.output
    fewer = call("quality", folder / "two", "--insert", VIALS, "-n", 4, "--truth", "--json")
    assert fewer.exit_code == 0, fewer.output
    assert json.loads(fewer.stdout)["ideal"] == pytest.approx(found["ideal"])  # counts know nothing of the run's bases
    with open_dataset(folder / "scan.h5") as dataset, pytest.raises(InputError, match="leave --truth out"):
        true_volumes(read_truth(dataset.path), dataset.grid, ("photoelectric", "kedge_50"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--insert", "1,2,3"), "an insert is X,Y,Z,RADIUS"),
        (("--insert", "0,0,500,10"), "lies outside of the volume"),
        (("--insert", "60,0,0,8"), "choose one further from the edge"),
        (("--insert", VIALS, "--as", "gold"), "concentration of Au"),
        (("--insert", VIALS, "--dataset", "OTHER"), "has another grid or other channels"),
    ],
)
def test_what_a_user_can_do_wrong(folder, tmp_path, options, words):
    if "OTHER" in options:
        make(tmp_path / "other.h5", *FEW, voxels=12)
        options = tuple(tmp_path / "other.h5" if option == "OTHER" else option for option in options)
    bare = tmp_path / "run"
    shutil.copytree(folder / "run", bare, ignore=shutil.ignore_patterns("replicates", "quality", "uncertainty.h5"))
    shutil.copy(folder / "scan.h5", tmp_path / "scan.h5")
    assert words in one_sentence(call("quality", bare, *options, "-q"))
    assert not (bare / "quality").exists()
