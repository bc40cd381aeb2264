"""Records of scans: rounding of processors is told from another scan."""

import shutil

import numpy as np
import pytest
from support.edited_datasets import edited_dataset
from support.tiny_scans import make

from phantomgen.suite.record import compare, record

COUNTS, FLATS = "/entry/instrument/detector/data", "/entry/instrument/flat/data"
SIZE = ("--views", "8", "--test-views", "2")


@pytest.fixture(scope="module")
def scan(tmp_path_factory):
    return make(tmp_path_factory.mktemp("record") / "scan.h5", *SIZE)


@pytest.fixture(scope="module")
def stored(scan):
    return {"scene": "a", **record(scan)}


@pytest.fixture
def changed(scan, tmp_path):
    """Record of a copy in which the values of one array are replaced."""

    def recorded(name, change):
        path = shutil.copy(scan, tmp_path / "changed.h5")
        with edited_dataset(path) as file:
            array = file[name]
            values = array[()]
            change(values)
            array[...] = values
        return {"scene": "a", **record(path)}

    return recorded


def test_the_same_scan_is_identical(scan, stored):
    assert compare({"scene": "a", **record(scan)}, stored) == ("identical", "")
    assert compare(stored, None) == ("not stored", "")
    assert compare({**stored, "scene": "b"}, stored) == ("different", "the definition of the scene changed")


def test_a_few_counts_are_rounding(changed, stored):
    def few(counts):
        counts[::3, 1, 5, 7:9] += 1

    assert compare(changed(COUNTS, few), stored) == (
        "same within rounding",
        "counts differ by what processors round",
    )


def test_one_image_with_other_noise_is_what_a_rejected_draw_gives(changed, stored):
    def noise(counts):
        counts[4, 0] += (counts[4, 0] ** 0.5 * 0.02).astype(int)  # two standard deviations of the total

    agreement, why = compare(changed(COUNTS, noise), stored)
    assert agreement == "same within rounding"
    assert why.endswith("of the images have other noise")


def test_other_energy_nodes_on_another_processor_are_rounding(changed, stored):
    """Means of a channel that differ by a tenth of the tolerance, and then other noise in every image."""

    def nodes(counts):
        shift = 1e-4 * counts[:, 1] + np.random.default_rng(0).normal(0, 0.5 * np.sqrt(counts[:, 1] + 1.0))
        counts[:, 1] = np.maximum(counts[:, 1] + np.rint(shift).astype(counts.dtype), 0)

    agreement, why = compare(changed(COUNTS, nodes), stored)
    assert agreement == "same within rounding", why


def test_a_thousandth_more_is_another_scan(stored):
    """The totals of a scan with many more counts, so that noise does not hide it."""
    many, more = ({**stored, "totals": (f * np.array(stored["totals"]) * 10**4).tolist()} for f in (1.0, 1.001))
    others = {name: {**array, "sha256": ""} for name, array in more["arrays"].items()}
    agreement, why = compare({**more, "arrays": others}, many)
    assert agreement == "different"
    assert why.startswith("counts changed by up to 1.0e-03 of their value")


OTHER = "sums over stated spectra, poses and views changed by up to"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        (COUNTS, "counts changed by up to 1"),
        (FLATS, "counts changed by up to 1"),
        ("/entry/spectra/source", OTHER),
        ("/entry/spectra/basis", OTHER),
        ("/entry/geometry/source", OTHER),
        ("/entry/geometry/panel_center", OTHER),
        ("/entry/exposure/scale", OTHER),
        ("/truth/basis/data", "sums over the truth changed by up to"),
    ],
)
def test_a_percent_more_is_another_scan(changed, stored, name, why):
    def more(values):
        values[...] = (1.01 * values).astype(values.dtype)

    agreement, said = compare(changed(name, more), stored)
    assert agreement == "different"
    assert said.startswith(why)


def test_views_in_another_sequence_are_another_scan(changed, stored):
    def turn(values):
        values[...] = values[::-1].copy()

    assert compare(changed("/entry/geometry/panel_center", turn), stored)[1].startswith(OTHER)


def test_a_mirrored_orbit_is_another_scan(changed, stored):
    def mirror(values):
        values[:, 1] *= -1

    assert compare(changed("/entry/geometry/source", mirror), stored)[1].startswith(OTHER)


def test_hashes_do_not_depend_on_compression_and_threads(scan, stored, tmp_path):
    other = make(tmp_path / "other.h5", *SIZE, "--compression", "none", "--threads", "2")
    assert other.read_bytes() != scan.read_bytes()
    assert record(other)["arrays"] == stored["arrays"]


def test_another_size_is_another_scan(stored, tmp_path):
    other = {"scene": "a", **record(make(tmp_path / "other.h5", *SIZE, rows=16))}
    assert compare(other, stored) == ("different", "counts have another shape")
