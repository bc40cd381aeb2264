"""Filtered back-projection beside RTK's, where that is installed."""

import importlib.util
from importlib import metadata
from pathlib import Path

import pytest
from support.tolerances import TOLERANCES

RTK = any(found.name == "itk-rtk" for found in metadata.distributions(name="itk-rtk"))
SCRIPT = Path(__file__).parents[2] / "benchmarks" / "peers" / "fdk.py"


@pytest.fixture(scope="module")
def peers():
    spec = importlib.util.spec_from_file_location("fdk_peers", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.skipif(not RTK, reason="needs itk-rtk")
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("orbit", ["full circle", "half-fan", "short scan"])
def test_perfect_data_give_the_volume_of_rtk(peers, orbit):
    ours, theirs, apart = peers.compared(orbit)
    assert ours > theirs - TOLERANCES["fdk_rtk"]
    assert apart > 50


@pytest.mark.parametrize("orbit", ["full circle", "half-fan", "short scan"])
def test_sharp_ellipsoids_come_back(peers, orbit):
    """What the comparison runs on is right even without the peer; its error is blur at the surfaces."""
    ours, again, _ = peers.compared(orbit, lambda images, geometry, short, half: peers.truth())
    assert ours > 34
    assert again > 200
