"""What ``recon fit --refine`` does: find small errors of the stated spectral model in the counts, and correct them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from shutil import copyfile
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from phantomgen.dataset.reader import Dataset
from recon.calibration.spectrum_file import read_spectrum, sensitivities_of, with_sensitivities, write_spectrum
from recon.data.measurements import read_measurements
from spectra.errors import InputError
from spectra.materials.material import Material

if TYPE_CHECKING:
    from recon.calibration.scoring import Maximum

# Standard deviations of the errors that are looked for: voltage [kV], filter [mm], thresholds [keV].
PRIORS = {"voltage": 2.0, "filter": 0.25, "thresholds": 1.0}
FILTER = "Al"
SPECTRUM = "spectrum.yaml"  # in a run folder
# A parameter is determined where its uncertainty is less than this part of its prior.
_DETERMINED = 0.5
# Deviance per degree of freedom above which the model does not explain the rays.
_POOR = 1.2


@dataclass(frozen=True, eq=False)
class Refinement:
    """Errors of a spectral model, as the counts show them.

    Parameters
    ----------
    dataset : with the corrected model
    names, units : of the errors
    prior : their standard deviations beforehand
    found : the estimate
    rays, freedom : number of rays, and of their counts less line integrals and errors
    before : deviance of the stated model
    """

    dataset: Dataset
    names: tuple[str, ...]
    units: tuple[str, ...]
    prior: Float[np.ndarray, " parameter"]
    found: "Maximum"
    rays: int
    freedom: int
    before: float

    @property
    def sentences(self) -> tuple[str, ...]:
        """The errors, and which of them are mostly those of the prior."""
        found = self.found
        parts = [
            f"{name} {value:+.2g} +- {sigma:.2g} {unit}"
            for name, value, sigma, unit in zip(self.names, found.values, found.uncertainty, self.units, strict=True)
        ]
        said = [
            f"Refined the spectrum on {self.rays} rays: {', '.join(parts)}; deviance per degree of freedom "
            f"{self.before / self.freedom:.3g} -> {found.deviance / self.freedom:.3g}"
        ]
        unknown = [n for n, s, p in zip(self.names, found.uncertainty, self.prior, strict=True) if s > _DETERMINED * p]
        if unknown:
            said.append(
                f"The counts hardly tell {' and '.join(unknown)}: other line integrals explain such an error as well, "
                "and its correction rests on the prior"
            )
        if found.deviance > _POOR * self.freedom:
            said.append(
                "The refined spectrum does not explain the counts within their noise: a basis function may be missing, "
                "or scatter be left out"
            )
        return tuple(said)

    def record(self) -> dict[str, Any]:
        """Summarise the refinement in plain values.

        Returns
        -------
        errors with uncertainties, and quality of the fit
        """
        rows = zip(self.names, self.units, self.found.values, self.found.uncertainty, self.prior, strict=True)
        errors = {
            name: {"error": _short(value), "uncertainty": _short(sigma), "prior": _short(prior), "unit": unit}
            for name, unit, value, sigma, prior in rows
        }
        return {
            "errors": errors,
            "rays": self.rays,
            "degrees_of_freedom": self.freedom,
            "deviance": {"stated": _short(self.before), "refined": _short(self.found.deviance)},
            "notes": list(self.sentences),
        }

    def write(self, path: Path) -> None:
        """Write errors and corrected sensitivities in the form that ``recon fit --spectrum`` reads.

        Parameters
        ----------
        path : YAML file
        """
        spectra = self.dataset.spectra
        write_spectrum(path, self.record(), sensitivities_of(spectra), spectra.channels)


@dataclass(frozen=True, eq=False)
class ChosenSpectrum:
    """Spectral model of a fit.

    Parameters
    ----------
    dataset : with the model
    refinement : how it was found; None where nothing was refined
    source : file that it was read from; None where it is that of the dataset
    """

    dataset: Dataset
    refinement: Refinement | None = None
    source: Path | None = None

    @classmethod
    def of(
        cls,
        dataset: Dataset,
        spectrum: Path | None,
        refine: str | None = None,
        priors: Mapping[str, float] | None = None,
    ) -> "ChosenSpectrum":
        """Take the spectral model of a file, and refine it.

        Parameters
        ----------
        dataset : open dataset
        spectrum : file of `recon calibrate`; None for the model of the dataset
        refine : ``spectrum`` or ``spectrum+air``; None for no refinement
        priors : see `refined`

        Returns
        -------
        the choice
        """
        voltage = None
        if spectrum is not None:
            known = read_spectrum(spectrum)
            dataset, voltage = with_sensitivities(dataset, known), float(known.edges[-1])
        if refine is None:
            return cls(dataset, None, spectrum)
        found = refined(dataset, priors, refine == "spectrum+air", voltage)
        return cls(found.dataset, found, spectrum)

    @classmethod
    def of_run(cls, dataset: Dataset, folder: Path) -> "ChosenSpectrum":
        """Take the spectral model that a run used.

        Parameters
        ----------
        dataset : open dataset of the run
        folder : run folder

        Returns
        -------
        the model of its ``spectrum.yaml``, or that of the dataset where it has none
        """
        path = folder / SPECTRUM
        return cls.of(dataset, path if path.is_file() else None)

    def note(self, tell: Callable[[str], None]) -> None:
        """Tell a user what was refined.

        Parameters
        ----------
        tell : takes a sentence
        """
        for sentence in self.refinement.sentences if self.refinement else ():
            tell(sentence)

    def write(self, path: Path) -> None:
        """Write the model where it is not that of the dataset.

        Parameters
        ----------
        path : YAML file
        """
        if self.refinement is not None:
            self.refinement.write(path)
        elif self.source is not None:
            copyfile(self.source, path)


def refined(
    dataset: Dataset, priors: Mapping[str, float] | None = None, air: bool = False, voltage: float | None = None
) -> Refinement:
    """Estimate errors of the spectral model of a dataset from its training views, and correct them.

    Parameters
    ----------
    dataset : open dataset
    priors : standard deviations by name, in place of those of `PRIORS`
    air : whether ratios of open-beam counts between channels are used, which needs channels of one efficiency
    voltage : of the stated spectrum, where it is not that of the file [kV]

    Returns
    -------
    the errors, and the dataset without them

    Raises
    ------
    InputError
        When there are not more channels than basis functions, attenuation is even in too few places, or a prior has no
        use.
    """
    from recon.calibration.perturbation import Perturbation  # noqa: PLC0415 - only where it is asked for
    from recon.calibration.ray_likelihood import RayLikelihood  # noqa: PLC0415
    from recon.calibration.scoring import maximise  # noqa: PLC0415
    from recon.calibration.smooth_blocks import smooth_blocks  # noqa: PLC0415

    spectra = dataset.spectra
    channels, bases = len(spectra.channels), len(spectra.basis.names)
    if channels <= bases and not air:
        raise InputError(
            f"{dataset.path} has {channels} channels and {bases} basis functions, so that its rays do not tell of the "
            "spectrum: more channels than functions are needed; name fewer by --bases, or measure known absorbers for "
            "`recon calibrate`"
        )
    unknown = set(priors or {}) - set(PRIORS)
    if unknown:
        raise InputError(f"a refinement has no prior of {unknown.pop()!r}: choose from {', '.join(PRIORS)}")
    perturbation = Perturbation.of(dataset, Material(FILTER, None, FILTER), voltage)
    measured = read_measurements(dataset, dataset.splits["train"])
    rays = smooth_blocks(measured)
    level = measured_air(dataset) if air else None
    likelihood = RayLikelihood(perturbation, rays.counts, rays.air, level)
    known = PRIORS | dict(priors or {})
    prior = np.array([known["thresholds" if name.startswith("threshold") else name] for name in perturbation.names])
    start = np.zeros(len(prior))
    found = maximise(likelihood.likelihood, start, prior)
    before = likelihood.likelihood(start).deviance
    freedom = len(rays.counts) * max(channels - bases, 0) + (channels - 1 if air else 0) - len(prior)
    corrected = dataset.with_spectra(perturbation.corrected(found.values, spectra))
    return Refinement(
        corrected, perturbation.names, perturbation.units, prior, found, len(rays.counts), max(freedom, 1), before
    )


def measured_air(dataset: Dataset) -> Float[np.ndarray, " channel"]:
    """Compute the open-beam counts of each channel, mean over the pixels that measure.

    Parameters
    ----------
    dataset : open dataset

    Returns
    -------
    counts
    """
    return np.mean(dataset.flat, axis=(1, 2), where=~dataset.mask)


def _short(value: float) -> float:
    """A number with six digits."""
    return float(f"{value:.6g}")
