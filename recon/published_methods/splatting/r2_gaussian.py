"""One set of Gaussians per channel or basis, each by itself: R2-Gaussian.

Local-affine footprints with the integration factor of R2-Gaussian, softplus densities, bounded standard deviations, a
start from filtered back-projection, L1, structural dissimilarity and the total variation of random patches, clone,
split and prune. Simplified: fewer steps with higher learning rates, fewer Gaussians and smaller patches; the start is
not half a voxel off.

References
----------
Zha, Lin, Cai, Cao, Zhang, Li 2024, R2-Gaussian: rectifying radiative Gaussian splatting for tomographic reconstruction,
NeurIPS, arXiv:2405.20693.
"""

from dataclasses import dataclass
from typing import ClassVar

from recon.published_methods.splatting.primitives import Attenuation
from recon.published_methods.splatting.volume_method import VolumeSplatting


@dataclass(frozen=True)
class GaussianMono(VolumeSplatting):
    """R2-Gaussian as a method.

    Parameters
    ----------
    density_share : density of a Gaussian over that of its voxel at the start; R2-Gaussian
    volume_tv : weight of the total variation of the volume; R2-Gaussian
    patch : edge of the patches whose total variation is computed [voxel]; R2-Gaussian's 32 takes half of the time
    """

    density_share: float = 0.15
    volume_tv: float = 0.05
    patch: int = 16

    primitives: ClassVar[Attenuation] = Attenuation()

    @property
    def name(self) -> str:
        """Name of the method for ``--method``."""
        return "gaussian-mono"
