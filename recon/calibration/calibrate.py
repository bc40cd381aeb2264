"""What `recon calibrate` does: estimate, judge, and write."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from recon.calibration.scoring import Maximum
from recon.calibration.spectrum_file import Sensitivities, write_spectrum
from recon.calibration.step_wedge import WedgeModel

_WIDTH = 1.0  # keV; of the energy bins that are written


@dataclass(frozen=True, eq=False)
class Calibration:
    """Estimated parameters of the channels of a scanner.

    Parameters
    ----------
    model : of the counts
    prior : standard deviation of the prior of each free parameter; infinite for none
    found : estimate
    """

    model: WedgeModel
    prior: Float[np.ndarray, " parameter"]
    found: Maximum

    @classmethod
    def of(cls, model: WedgeModel, prior: Float[np.ndarray, " parameter"]) -> "Calibration":
        """Estimate the free parameters.

        Parameters
        ----------
        model : of the counts
        prior : standard deviation of each prior; infinite for none

        Returns
        -------
        the calibration
        """
        return cls(model, prior, model.fit(prior))

    @property
    def sentences(self) -> tuple[str, ...]:
        """State what the data cannot tell, and where the model does not explain them."""
        found = (self.found.inseparable(self.model.names, self.model.units), self.model.misfit(self.found))
        return tuple(sentence for sentence in found if sentence is not None)

    @property
    def values(self) -> Float[np.ndarray, " argument"]:
        """All arguments of the channel model, estimated or known."""
        return self.model.all_values(self.found.values)

    def sensitivities(self) -> Sensitivities:
        """Compute source and response on bins of 1 keV that end at thresholds and edges.

        Returns
        -------
        the sensitivities
        """
        channel_model, values = self.model.model, self.values
        source = channel_model.source(values)
        detector = channel_model.detector(values, source.maximum)
        low = max(float(channel_model.energies.edges[0]), detector.lowest)
        grid = source.grid(low, round((source.maximum - low) / _WIDTH), detector.breaks)
        energies, photons = source.sampled(grid)
        limits = np.array([(channel.lower, channel.upper) for channel in detector.channels]).T
        return Sensitivities(
            energies.edges, energies.nodes, photons / photons.sum(), detector.response(energies), *limits
        )

    def record(self) -> dict[str, Any]:
        """Summarise the calibration in plain values.

        Returns
        -------
        parameters, quality of the fit and sentences
        """
        model, found = self.model, self.found
        covariance = found.covariance
        sigma = np.sqrt(np.diag(covariance))
        parameters: dict[str, Any] = {}
        for i, (name, unit) in enumerate(zip(model.names, model.units, strict=True)):
            parameters[name] = {
                "value": _short(found.values[i]),
                "uncertainty": _short(sigma[i]),
                "if_others_known": _short(found.alone[i]),
                "unit": unit,
                "start": float(model.start[model.free][i]),
            }
            if np.isfinite(self.prior[i]):
                parameters[name]["prior"] = float(self.prior[i])
        known = {n: float(v) for n, v, f in zip(model.all_names, model.start, model.free, strict=True) if not f}
        with np.errstate(invalid="ignore"):
            correlation = covariance / np.outer(sigma, sigma)
        return {
            "parameters": parameters,
            "known": known,
            "correlation": [[round(float(v), 4) for v in row] for row in correlation],
            "deviance": _short(found.deviance),
            "degrees_of_freedom": model.freedom,
            "notes": list(self.sentences),
        }

    def write(self, path: Path) -> None:
        """Write the calibration in the form that ``recon fit --spectrum`` reads.

        Parameters
        ----------
        path : YAML file
        """
        channels = tuple(f"bin{c}" for c in range(self.model.wedge.counts.shape[1]))
        write_spectrum(path, self.record(), self.sensitivities(), channels)

    def lines(self) -> list[str]:
        """Return a table for the terminal.

        Returns
        -------
        one line per parameter
        """
        found = self.found
        rows = zip(self.model.names, self.model.units, found.values, found.uncertainty, strict=True)
        return [f"{name:<14}{value:10.4g} +- {sigma:<8.2g} {unit}" for name, unit, value, sigma in rows]


def _short(value: float) -> float:
    """A number with six digits."""
    return float(f"{value:.6g}")
