"""Parts of the paper's method that can be switched off one by one, as in its ablation (table 4c)."""

from collections.abc import Iterable

from spectra.errors import InputError

COMPONENTS = {
    "kedge-freezing": "parameters of the K edge rest at first (table 4c)",
    "tv": "both total variations (table 4c)",
    "split-threshold": "a threshold of its own for splitting (table 4c); one for both without",
    "polychromatic": "the integral over energy (table 4c); one energy per channel without",
    "local-affine": "the footprint of R2-Gaussian; the exact line integral without",
    "volume-tv": "total variation of the channels' volumes",
    "image-tv": "total variation of the bases' projections",
    "dssim": "structural dissimilarity beside L1",
    "conditioning": "the K-edge column made orthogonal to the other two",
    "kedge-learning": "the K edge follows the gradient; it stays where it starts without",
    "kedge-gate": "dense Gaussians start with more K edge; all with the same part of photoelectric without",
    "fraction-start": "first fractions from density; equal ones without",
    "fraction-reset": "fractions are drawn back to the middle from time to time",
    "fraction-rate": "fractions learn faster than density; as fast without",
    "rate-decay": "learning rates fall; they stay without",
    "densification": "Gaussians are cloned and split",
    "pruning": "Gaussians without density or outside the grid are removed",
}


def checked(names: Iterable[str]) -> tuple[str, ...]:
    """Names of components, each once, in the order of `COMPONENTS`.

    Raises
    ------
    InputError
        When there is no such component; the sentence lists those that there are.
    """
    wanted = set(names)
    unknown = sorted(wanted - set(COMPONENTS))
    if unknown:
        raise InputError(f"--without {unknown[0]}: there is no such component; choose from {', '.join(COMPONENTS)}")
    return tuple(name for name in COMPONENTS if name in wanted)
