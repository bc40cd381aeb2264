import numpy as np
import pytest
from support.one_channel_scans import BONE, FAT, ROD, WATER, one_channel_scan

from phantomgen.dataset.truth import read_truth
from recon.data.measurements import read_measurements
from recon.kedge.basis_names import OnCurve


class OneChannel:
    """A scan with what its tests need."""

    def __init__(self, dataset):
        self.grid, self.curve = dataset.grid, OnCurve().curve(dataset)
        self.measured = read_measurements(dataset, dataset.splits["train"], separable=False)
        self.truth = read_truth(dataset.path)
        self.at_70 = dataset.spectra.basis.evaluate(np.array([70.0]))[:, 0]

    def mono(self, volumes):
        """Attenuation at 70 keV [1/mm]."""
        return np.einsum("m,mzyx->zyx", self.at_70, volumes)

    def decibels(self, volumes):
        """PSNR of the attenuation at 70 keV outside of metal, over the attenuation of bone."""
        true = self.mono(self.truth.volumes)
        error = (self.mono(volumes) - true)[true < 0.06]
        return 10 * np.log10(0.05**2 / np.mean(error**2))


@pytest.fixture(scope="session")
def water(tmp_path_factory):
    path = tmp_path_factory.mktemp("one-channel") / "water.h5"
    return OneChannel(one_channel_scan(path, WATER, noise=False))


@pytest.fixture(scope="session")
def rod(tmp_path_factory):
    path = tmp_path_factory.mktemp("one-channel") / "rod.h5"
    return OneChannel(one_channel_scan(path, WATER, BONE, FAT, ROD))
