"""Choice of the basis of a fit: how many functions the data warrant, and where their K edges lie."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from phantomgen.dataset.reader import Dataset
from recon.gaussians.recipe import Recipe
from recon.kedge.basis_names import Asked, OnCurve, with_named
from recon.kedge.edge_likelihood import EdgeLikelihood, Functions
from recon.kedge.elements import plain_alternatives, settle_elements
from recon.kedge.judgement import LEAST_SCORE, Judgement, judge, judge_by_neighbours
from recon.kedge.profile_likelihood import EdgeProfile
from recon.kedge.rays import rays_away_from_edges
from recon.kedge.search import ROUNDS, likeliest_edge, refine_together
from recon.kedge.spatial_correlation import between_channels
from spectra.basis.basis import Basis, BasisFunction
from spectra.errors import InputError

# no unit; relative model error that a fit concedes, so that a misfit of that size is no K edge
DISPERSION = Recipe().dispersion
SAME = 2.0  # keV; a found edge closer than this to one of the file is that one; chosen by hand, not measured
THINNED = 4  # every such ray is used to choose elements again while edges are still missing; bounds the time
SURE = 3.0  # standard deviations by which the edge of an element of the file may differ from the found energy


@dataclass(frozen=True, eq=False)
class BasisChoice:
    """The chosen basis, and the reasons.

    Parameters
    ----------
    basis : basis of the fit
    judgements : one per function that was judged
    profiles : profiles of the K edges that were found, with the names of their functions
    """

    basis: Basis
    judgements: tuple[Judgement, ...] = ()
    profiles: tuple[tuple[str, EdgeProfile], ...] = ()

    @property
    def sentences(self) -> list[str]:
        """Explanation for a user."""
        judged = [
            f"{j.name} is {'warranted' if j.warranted else 'not warranted'} beside {', '.join(j.before)}: {j.reason} "
            f"(deviance per ray {j.deviance_before:.3g} without it, {j.deviance_after:.3g} with it, {j.rays} rays)"
            for j in self.judgements
        ]
        elements = {f.name: f" ({f.element})" for f in self.basis.functions if f.kind == "element"}
        found = [
            f"K edge at {p.best:.2f} keV{elements.get(name, '')}, 1 sigma from {p.low:.2f} to {p.high:.2f} keV, "
            f"Cramer-Rao {p.bound:.2g} keV"
            for name, p in self.profiles
        ]
        return judged + found

    def record(self) -> dict[str, Any]:
        """Summarise the choice for ``metrics.json``.

        Returns
        -------
        names, edges and judgements
        """
        functions = {f.name: f for f in self.basis.functions}
        return {
            "names": list(self.basis.names),
            "edges": [
                {
                    "name": name, "kind": functions[name].kind, "element": functions[name].element,
                    "energy_keV": functions[name].edge_energy, "found_keV": p.best, "low_keV": p.low,
                    "high_keV": p.high, "sigma_keV": p.sigma, "bound_keV": p.bound, "rays": p.rays,
                }
                for name, p in self.profiles
            ],
            "judgements": [asdict(j) for j in self.judgements],
        }  # fmt: skip


def choose_basis(dataset: Dataset, bases: Asked = None, edges: Sequence[float] | None = None) -> BasisChoice:
    """Choose the basis functions to fit a dataset with; only ``/entry`` is read.

    Parameters
    ----------
    dataset : an open dataset
    bases : number of functions, or names of functions of the file, which are not judged; for a curve of materials all
        without a K edge; None for those that the data warrant
    edges : None to use the K edges that the file states; otherwise edges are searched at all energies. Numbers are
        energies to try besides [keV] and fix the number of edges; without numbers, `bases` and the data decide

    Returns
    -------
    the basis and the reasons

    Raises
    ------
    InputError
        When a K edge was asked for that the channels or the counts do not show, or a name that the file does not have.
    """
    stated = dataset.spectra.basis
    if bases is not None and not isinstance(bases, int):
        if edges is not None:
            how = "lie on a curve of materials" if isinstance(bases, OnCurve) else "are named"
            raise InputError(f"bases {how}, and a K edge that is looked for has no name: give their number instead")
        return BasisChoice(with_named(dataset, bases)[0].spectra.basis)
    lowest, highest = dataset.spectra.edges[[0, -1]]
    for energy in edges or ():
        if not lowest < energy < highest:
            raise InputError(
                f"a K edge at {energy:g} keV cannot be seen by {dataset.path}: photons of {lowest:g} to {highest:g} "
                "keV are detected"
            )
    if stated.signed:
        return BasisChoice(stated)
    known = [f for f in stated.functions if f.edge_energy is not None]
    plain = tuple(f for f in stated.functions if f.edge_energy is None)
    if edges is None and bases is not None and bases <= len(stated):
        return BasisChoice(Basis(stated.functions[:bases], stated.reference_energy))
    if edges is None and not known and bases is None:
        return BasisChoice(stated)
    if edges is None and bases is None:
        return _warranted(dataset, plain, known)
    kept = plain if edges is not None else (*plain, *known)
    wanted = _wanted(dataset, bases, edges or (), kept)
    return _searched(dataset, kept, known, wanted, edges or ())


def find_edges(dataset: Dataset, starts: Sequence[float] = ()) -> BasisChoice:
    """Find all K edges that the counts show beside the functions without an edge, at least one.

    Parameters
    ----------
    dataset : an open dataset
    starts : energies to try besides [keV], one per edge; without any, the data decide on the number of edges

    Returns
    -------
    the basis with these edges, and the reasons

    Raises
    ------
    InputError
        When there is no edge, or there are fewer than `starts`.
    """
    choice = choose_basis(dataset, None, starts)
    if not choice.profiles:
        raise InputError(_not_found(dataset, choice.judgements))
    return choice


def _wanted(dataset: Dataset, bases: int | None, starts: Sequence[float], kept: Functions) -> int | None:
    """Number of edges to find; None for those that the data warrant."""
    if bases is None:
        wanted = len(starts) or None
    else:
        wanted = bases - len(kept)
        if wanted < 1 or len(starts) > wanted:
            names = ", ".join(f.name for f in kept)
            raise InputError(
                f"{bases} bases leave room for {max(wanted, 0)} K edges beside {names}, but {len(starts) or 1} were "
                "asked for: ask for more bases or fewer edges"
            )
    bins = len(dataset.spectra.channels)
    least = len(kept) + (wanted or 1) + 1
    if bins < least:
        raise InputError(
            f"{dataset.path} has the bases {', '.join(dataset.spectra.basis.names)}: {least - 1} were asked for, and a "
            f"K edge whose energy is not known needs a channel more than there are bases, at least {least}, not {bins}"
        )
    return wanted


def _likelihood(dataset: Dataset, plain: Functions, binned: bool = True) -> EdgeLikelihood:
    """Likelihood of all rays that may be judged."""
    reference = dataset.spectra.basis.reference_energy
    rays = rays_away_from_edges(dataset.with_basis(Basis(plain, reference)), binned)
    floor = dataset.dark_variance / dataset.spectra.quantum**2
    return EdgeLikelihood(rays, dataset.spectra, floor, DISPERSION)


def _warranted(dataset: Dataset, plain: Functions, known: Sequence[BasisFunction]) -> BasisChoice:
    """Choose the functions of the file that the data warrant, the one with the highest score first."""
    stated = dataset.spectra.basis
    if len(dataset.spectra.channels) <= len(plain):
        return BasisChoice(stated)
    likelihood = _likelihood(dataset, plain)
    if likelihood.rays.channels <= len(plain):
        return BasisChoice(stated)
    pixels: EdgeLikelihood | None = None
    taken, left, judgements = plain, list(known), []
    while left and likelihood.rays.channels > len(taken):
        judged = [judge(likelihood, taken, f) for f in left]
        if not any(one.warranted for one in judged):
            pixels = pixels or _likelihood(dataset, plain, binned=False)
            judged = [_by_neighbours(pixels, taken, f, one) for f, one in zip(left, judged, strict=True)]
        best = max(range(len(left)), key=lambda i: (judged[i].warranted, judged[i].score))
        if not judged[best].warranted:
            judgements += judged
            break
        judgements.append(judged[best])
        taken = (*taken, left.pop(best))
    order = [f for f in stated.functions if f in taken]
    return BasisChoice(Basis(tuple(order), stated.reference_energy), tuple(judgements))


def _by_neighbours(pixels: EdgeLikelihood, taken: Functions, function: BasisFunction, judged: Judgement) -> Judgement:
    """Judgement by neighbouring rays where the counts can show the jump of an edge; `judged` elsewhere."""
    shown = between_channels(pixels.spectra, float(function.edge_energy or 0.0))
    return judge_by_neighbours(pixels, taken, function, judged) if shown else judged


def _searched(
    dataset: Dataset, kept: Functions, known: Sequence[BasisFunction], wanted: int | None, starts: Sequence[float]
) -> BasisChoice:
    """Find edges one after the other, then refine them together."""
    reference = dataset.spectra.basis.reference_energy
    likelihood = _likelihood(dataset, kept)
    steps = [f for f in known if f.kind in ("step", "sigmoid")]
    edge_shape = steps[0] if steps else BasisFunction("step", edge_energy=reference)
    choices = plain_alternatives(kept)
    found: list[BasisFunction] = []
    profiles: list[EdgeProfile] = []
    judgements: list[Judgement] = []
    seen = likelihood
    while wanted is None or len(found) < wanted:
        if likelihood.rays.channels < len(kept) + len(found) + 2:
            break
        edge = likeliest_edge(likelihood, choices, found, edge_shape, starts)
        judgements.append(edge.judgement)
        if not edge.judgement.warranted:
            break
        choices = (edge.plain,)
        seen = likelihood.with_rays(seen.rays.joined(edge.rays) if found else edge.rays)
        found.append(edge.function)
        profiles.append(edge.profile)
        if len(found) > 1:
            found = settle_elements(seen.with_rays(seen.rays[::THINNED]), edge.plain, found, ROUNDS)
    if wanted is not None and len(found) < wanted:
        raise InputError(_not_found(dataset, judgements))
    if len(found) > 1:
        found, profiles = map(list, zip(*refine_together(seen, choices[0], found), strict=True))
    functions = [_settled(f, p, known) for f, p in zip(found, profiles, strict=True)]
    names = tuple((f.name, p) for f, p in zip(functions, profiles, strict=True))
    return BasisChoice(Basis((*kept, *functions), reference), tuple(judgements), names)


def _not_found(dataset: Dataset, judgements: Sequence[Judgement]) -> str:
    """Sentence why an edge that was asked for is not used, and what would help."""
    if not judgements:
        return (
            f"no ray of {dataset.path} was measured in enough channels at once to find a K edge: leave --edge out, so "
            "that the energies which the file states are used"
        )
    last = judgements[-1]
    need = "a whole channel below and above it" if last.score >= LEAST_SCORE else "a stronger contrast"
    return (
        f"no K edge shows in {dataset.path} beside {', '.join(last.before)}: the best one, at {last.edge:.4g} keV, is "
        f"not taken since {last.reason}; more photons or {need} would help, or use --bases {len(last.before)}"
    )


def _settled(found: BasisFunction, profile: EdgeProfile, known: Sequence[BasisFunction]) -> BasisFunction:
    """Function to fit with: that of the file if it has the element with this edge, otherwise one at the found energy.

    Within `SAME` of an edge that the file states, the name stays, so that volumes and scores have one name.
    """
    near = min(known, key=lambda f: abs(float(f.edge_energy or 0.0) - profile.best), default=None)
    named = found if found.kind == "element" else replace(found, name=f"kedge_{profile.best:.1f}")
    if near is None or abs(float(near.edge_energy or 0.0) - profile.best) > SAME:
        return named
    if found.kind == "element":
        return near if near.element == found.element else replace(found, name=near.name)
    if near.kind == "element":
        off = abs(float(near.edge_energy or 0.0) - profile.best)
        return near if off <= max(SURE * profile.sigma, SAME / 2) else named
    return replace(near, edge_energy=profile.best)
