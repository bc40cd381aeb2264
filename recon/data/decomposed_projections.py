"""Line integrals of the basis functions of a whole scan, as projections for other programs."""

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.inpainting import inpainted
from phantomgen.dataset.reader import Dataset
from phantomgen.exporters.projections import Projections
from recon.data.material_decomposition import decompose_views
from recon.data.measurements import read_measurements


def decomposed_projections(dataset: Dataset, bases: int | None = None) -> Projections:
    """Decompose all views into line integrals of the basis functions, each pixel by maximum likelihood.

    Nothing is smoothed. Channels that a view lacks are interpolated between its neighbours; blind pixels are
    interpolated between those around them.

    Parameters
    ----------
    dataset : open dataset
    bases : number of basis functions, the first ones of the dataset; all by default

    Returns
    -------
    the projections, training views first; a view is decomposed when it is asked for
    """
    train, test = (dataset.splits[name] for name in ("train", "test"))
    views = np.concatenate([train, test])
    order = np.argsort(views)  # neighbours in time
    measured = read_measurements(dataset, views[order], bases).completed()
    place = np.argsort(order)

    def image(view: int) -> Float[np.ndarray, "basis row column"]:
        return inpainted(decompose_views(measured[[int(place[view])]])[0][0], measured.blind_pixels)

    return Projections(
        title=dataset.name,
        kind="line-integrals",
        names=measured.basis_names,
        geometry=dataset.geometry[views],
        train=len(train),
        grid=dataset.grid,
        image=image,
        energies=(float("nan"),) * len(measured.basis_names),
    )
