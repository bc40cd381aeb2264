"""Photon-counting detectors whose pulses are not as high as the photon's energy.

The counts of channel c per photon of energy E are A(E) times the integral of R(E'|E) over the channel, with A the part
that the sensor absorbs and R the pulses in *all* pixels per absorbed photon: a Gaussian photopeak, peaks at E less the
energy of fluorescence that got away, fluorescence absorbed in another pixel, and a continuum of shared charge. R is not
normalised, as a photon may count in several pixels.

With Compton scattering, photons that the sensor stops are absorbed or scattered, and R is that of the electron and of
what becomes of the scattered photon, see `spectra.detector.compton`. Without, every one counts as absorbed, which is
wrong for silicon. Left out are a second generation of fluorescence, and the loss of charge on its way through the
sensor. Pile-up is in `spectra.detector.pile_up`.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from spectra.detector.compton import interacts_again, interacts_anywhere, scattering
from spectra.detector.counters import between_thresholds
from spectra.detector.detector import Detector
from spectra.detector.semiconductor import charge_fractions, escape, fluorescence_events
from spectra.elements.attenuation import (
    LOWEST_ENERGY,
    attenuation_parts,
    compton_share,
    k_lines,
    k_shell_share,
    mass_fractions,
)
from spectra.energy.grid import Energies
from spectra.errors import InputError
from spectra.threads import run_parallel

EnergyArray = Float[np.ndarray, " energy"]
PerChannel = Float[np.ndarray, "channel energy"]

# Full width at half maximum of a Gaussian over its standard deviation, no unit.
_FWHM = 2 * np.sqrt(2 * np.log(2))
# Below so many standard deviations of the electronics a threshold counts noise.
_NOISE_FREE = 4.0
# A photon below a threshold by more than so many standard deviations is not counted.
_REACH = 5.0
# Sharpest resolution that pixels are tabulated for [keV], and how finely.
_SHARPEST = 1.0
# Energies that are tabulated per standard deviation of the resolution, for charge clouds and for fluorescence; between
# them values are cubic splines.
_CLOUD_STEPS, _EVENT_STEPS = 8, 2
# Part of Compton scattering in the attenuation of the sensor, no unit; a larger one is warned of.
_POOR_COMPTON = 0.2
# Energies between which counts of scattered photons are interpolated [keV].
_COMPTON_STEP = 0.5
_NEGLIGIBLE = 1e-9  # counts per absorbed photon


@dataclass(frozen=True)
class ChargeSharing:
    """Charge sharing between pixels.

    Parameters
    ----------
    pitch : of the sensor's square pixels [mm]
    cloud : standard deviation of a charge cloud [mm]
    covariance : whether simulated counts of neighbouring pixels have the covariance that shared charge gives them
    """

    pitch: float
    cloud: float
    covariance: bool = False

    def __post_init__(self) -> None:
        if not 0 < self.pitch < np.inf:
            raise InputError(f"the pitch of a sensor's pixels must be positive and finite, got {self.pitch:g} mm")
        if not 0 <= self.cloud < self.pitch:
            raise InputError(f"a charge cloud must be smaller than a pixel of {self.pitch:g} mm, got {self.cloud:g} mm")


@dataclass(frozen=True)
class PulseHeightDetector(Detector):
    """Photon-counting detector with finite energy resolution, K fluorescence and charge sharing.

    Parameters
    ----------
    resolution : full width at half maximum of the photopeak [keV], the same at all energies
    fluorescence : whether K fluorescence of the sensor is followed
    charge_sharing : pixels and charge clouds; None for pixels that keep all charge and all fluorescence that does not
        leave the sensor
    compton : whether photons scatter in the sensor
    """

    resolution: float = 0.0
    fluorescence: bool = False
    charge_sharing: ChargeSharing | None = None
    compton: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 <= self.resolution < np.inf:
            raise InputError(f"the resolution must be finite and not negative, got {self.resolution:g} keV")
        if self.charge_sharing is not None and self.resolution < _SHARPEST:
            raise InputError(
                f"shared charge needs a resolution of at least {_SHARPEST:g} keV, got {self.resolution:g} keV"
            )
        if self.compton and self.resolution < _SHARPEST:
            raise InputError(
                f"Compton scattering needs a resolution of at least {_SHARPEST:g} keV, got {self.resolution:g} keV"
            )
        if self.channels[0].lower < _NOISE_FREE * self.sigma:
            raise InputError(
                f"a threshold of {self.channels[0].lower:g} keV counts electronic noise at a resolution of "
                f"{self.resolution:g} keV: it must be at least {_NOISE_FREE * self.sigma:.3g} keV"
            )

    @property
    def sigma(self) -> float:
        """Standard deviation of the photopeak [keV]."""
        return self.resolution / _FWHM

    @property
    def lowest(self) -> float:
        """Energy below which no photon is counted [keV]."""
        return max(LOWEST_ENERGY, self.channels[0].lower - _REACH * self.sigma)

    @property
    def breaks(self) -> tuple[float, ...]:
        """Thresholds, also those reached in spite of a lost fluorescence photon, and K edges of the sensor [keV]."""
        top = self.channels[-1].upper
        edges = self.material.k_edges(self.lowest, top)
        lost = {t + energy for t in self.thresholds for _, energy, _ in self.lines} if self.resolution == 0 else set()
        return tuple(sorted({*self.thresholds, *edges, *(e for e in lost if e < top)}))

    @property
    def model_warnings(self) -> tuple[str, ...]:
        """A sentence where Compton scattering in the sensor matters."""
        if self.compton:
            return ()
        top = self.channels[-1].upper
        share = float(compton_share(self.composition, np.array([top]))[0])
        if share < _POOR_COMPTON:
            return ()
        return (
            f"the detector's response leaves out Compton scattering in the sensor, {share:.0%} of what "
            f"{self.material.name} attenuates at {top:g} keV: set detector.compton: true, or take a response matrix",
        )

    def response(self, energies: Energies) -> PerChannel:
        """Compute the counts of each channel in all pixels, per photon of each bin.

        Parameters
        ----------
        energies : energy bins

        Returns
        -------
        counts per photon, (channel, energy)
        """
        energy = energies.nodes
        return self.absorption(energy) * self.pulses(energy)

    def absorption(self, energy: EnergyArray) -> EnergyArray:
        """Compute the fraction of the photons that the sensor absorbs, or scatters with a change of energy.

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        fraction of each energy
        """
        return -np.expm1(-self.thickness * self._stopping(energy)) if self.compton else super().absorption(energy)

    def pulses(self, energy: EnergyArray) -> PerChannel:
        """Compute the counts of each channel in all pixels, per photon of each energy that the sensor stops.

        Parameters
        ----------
        energy : photon energies [keV]

        Returns
        -------
        counts per such photon, (channel, energy)
        """
        counts = self._counts_of_absorbed(energy)
        if self.compton:
            absorbed = self._absorbed_share(energy)
            known, scattered = self._counts_of_scattered
            counts = absorbed * counts + (1 - absorbed) * np.stack([np.interp(energy, known, row) for row in scattered])
        return np.where(counts > _NEGLIGIBLE, counts, 0.0)

    def _counts_of_absorbed(self, energy: EnergyArray) -> PerChannel:
        """Counts of each channel in all pixels, per photon that is absorbed."""
        counts = whole = self._counts_of_clouds(energy)
        for number, line, per_hole in self.lines:
            emitted = per_hole * k_shell_share(self.composition, number, energy)
            if self.compton:  # of the photons that are absorbed, not of all
                parts = attenuation_parts(self.composition, energy)
                emitted = emitted * parts.sum(axis=0) / parts[0]
            counts = counts + emitted * (self._with_fluorescence(energy, line) - whole)
        return counts

    def _stopping(self, energy: EnergyArray) -> EnergyArray:
        """Attenuation by absorption and Compton scattering [1/mm]."""
        parts = attenuation_parts(self.composition, energy)
        return self.material.attenuation(energy) * (parts[0] + parts[1]) / parts.sum(axis=0)

    def _absorbed_share(self, energy: EnergyArray) -> EnergyArray:
        """Part of the photons that the sensor stops which are absorbed at once."""
        absorbed, scattered, _ = attenuation_parts(self.composition, energy)
        return absorbed / (absorbed + scattered)

    @cached_property
    def _counts_of_scattered(self) -> tuple[EnergyArray, PerChannel]:
        """Energies [keV], and counts of each channel in all pixels per photon of them that is scattered."""
        energy = np.arange(LOWEST_ENERGY, self.channels[-1].upper + _COMPTON_STEP, _COMPTON_STEP)
        found = scattering(self.composition, energy)
        after = np.maximum(found.energy, LOWEST_ENERGY)
        mu, mu_after = self._stopping(energy), self._stopping(after.ravel()).reshape(after.shape)
        absorbed = self._absorbed_share(after.ravel()).reshape(after.shape)
        electrons = self._counts_of_clouds((energy[:, None] - found.energy).ravel()).reshape(len(self), *after.shape)
        counts_absorbed = absorbed * self._counts_of_absorbed(after.ravel()).reshape(electrons.shape)
        counts = (electrons * found.weight).sum(axis=2)
        # Photons that have scattered before: from anywhere in the sensor, in any direction. What they become has less
        # energy, so that its counts are known already where energies ascend, but for those near the top.
        again = found.weight * interacts_anywhere(mu_after, self.thickness)
        later = counts + (counts_absorbed * again).sum(axis=2)
        place = np.clip((after - energy[0]) / _COMPTON_STEP, 0, len(energy) - 1)
        for i in range(len(energy)):
            row = np.minimum(place[i].astype(int), i)
            upper, weight = np.where(row < i, place[i] - row, 0.0), again[i] * (1 - absorbed[i])
            shares = np.bincount(row, weight * (1 - upper), i + 1) + np.bincount(
                np.minimum(row + 1, i), weight * upper, i + 1
            )
            later[:, i] = (later[:, i] + later[:, :i] @ shares[:i]) / (1 - shares[i])
        again = found.weight * interacts_again(mu, mu_after, self.thickness, found.cosine)
        scattered = np.stack([np.interp(after, energy, row) for row in later]) * (1 - absorbed)
        counts += ((counts_absorbed + scattered) * again).sum(axis=2)
        return energy, counts

    def _with_fluorescence(self, energy: EnergyArray, line: float) -> PerChannel:
        """Counts of each channel in all pixels, per absorbed photon that emits fluorescence of `line` [keV]."""
        mu_line = float(self.material.attenuation(np.array([line]))[0])
        escaped = escape(self.material.attenuation(energy), mu_line, self.thickness)
        without = self._counts_of_clouds(np.maximum(energy - line, 0.0))
        if self.charge_sharing is None:
            return escaped * without + (1 - escaped) * self._counts_of_clouds(energy)
        # Pixels that get charge of the fluorescence, and what charge of the photon itself adds to them.
        moved = self._counts_of_clouds(np.array([line])) * (1 - escaped)
        return escaped * without + moved + between_thresholds(self._raised_by_photon[line](np.maximum(energy, line)))

    def _counts_of_clouds(self, deposited: EnergyArray) -> PerChannel:
        """Counts of each channel in all pixels, per charge cloud of each energy [keV]."""
        if self.charge_sharing is None:
            return between_thresholds(np.stack([self._fraction_above(deposited, t) for t in self.thresholds]))
        return np.maximum(between_thresholds(self._pixels_above(deposited)), 0.0)

    @cached_property
    def _pixels_above(self) -> CubicSpline:
        """Pixels above each threshold per charge cloud, as a function of its energy [keV]."""
        fractions, pixels = charge_fractions(*self._pitch_and_cloud)
        energy = self.energy_grid(0.0, _CLOUD_STEPS)
        above = [ndtr((energy[:, None] * fractions - t) / self.sigma) @ pixels for t in self.thresholds]
        return CubicSpline(energy, np.stack(above), axis=1)

    @cached_property
    def _raised_by_photon(self) -> dict[float, CubicSpline]:
        """For each line: pixels above each threshold only by the charge that the photon left there."""
        lines = [line for _, line, _ in self.lines]
        return dict(zip(lines, run_parallel(self._raised_by_photon_of_line, lines), strict=True))

    def _raised_by_photon_of_line(self, line: float) -> CubicSpline:
        """Compute the entry of `_raised_by_photon` for one line, as a function of the photon's energy [keV]."""
        mu_line, limits = float(self.material.attenuation(np.array([line]))[0]), np.array(self.thresholds)[:, None]
        energy = self.energy_grid(line, _EVENT_STEPS)
        above = np.empty((len(self), len(energy)))
        for i, (e, mu) in enumerate(zip(energy, self.material.attenuation(energy), strict=True)):
            events = fluorescence_events(float(mu), mu_line, self.thickness, *self._pitch_and_cloud)
            alone = line * events.fluorescence_fraction - limits
            raised = ndtr((alone + (e - line) * events.photon_fraction) / self.sigma) - ndtr(alone / self.sigma)
            above[:, i] = raised @ events.weights
        return CubicSpline(energy, above, axis=1)

    def energy_grid(self, low: float, steps: int) -> EnergyArray:
        """Compute evenly spaced energies from a lowest one to above the highest threshold.

        Parameters
        ----------
        low : lowest energy [keV]
        steps : energies per standard deviation of the photopeak

        Returns
        -------
        energies [keV]
        """
        width = max(self.channels[-1].upper - low, 0.0) + 1.0
        return np.linspace(low, low + width, int(np.ceil(width / self.sigma * steps)) + 2)

    @property
    def _pitch_and_cloud(self) -> tuple[float, float]:
        """Pitch and charge cloud [mm]; only with `charge_sharing`."""
        return (np.inf, 0.0) if self.charge_sharing is None else (self.charge_sharing.pitch, self.charge_sharing.cloud)

    def _fraction_above(self, energy: EnergyArray, threshold: float) -> EnergyArray:
        """Part of the pulses of an energy that reach a threshold."""
        return (energy >= threshold) * 1.0 if self.sigma == 0 else ndtr((energy - threshold) / self.sigma)

    @property
    def composition(self) -> str | dict[str, float]:
        """Composition of the sensor."""
        return self.material.composition or {}  # type: ignore[return-value]

    @cached_property
    def lines(self) -> tuple[tuple[int, float, float], ...]:
        """Atomic number, energy [keV] and photons per ionised K shell of the lines above `LOWEST_ENERGY`."""
        if not self.fluorescence:
            return ()
        found = [(number, *line) for number, _ in mass_fractions(self.composition) for line in k_lines(number)]
        return tuple((number, line, rate) for number, line, rate in found if line > LOWEST_ENERGY and rate > 0)
