"""Table of the voxel and view methods that ``recon fit --method`` offers.

A new method is a file with a frozen dataclass that is a `recon.voxel.method.LinearMethod`, `CountsMethod` or
`ViewMethod`, and a line in `METHODS`. Modules are imported when their method is asked for.
"""

from dataclasses import fields, replace
from importlib import import_module
from typing import TYPE_CHECKING

from spectra.errors import InputError

if TYPE_CHECKING:
    from recon.voxel.method import Method, ViewMethod

METHODS = {  # name -> module below recon, and class
    "fdk": ("voxel.filtered.fdk", "Fdk"),
    "sirt": ("voxel.iterative.sirt", "Sirt"),
    "sart": ("voxel.iterative.sart", "Sart"),
    "cgls": ("voxel.iterative.cgls", "Cgls"),
    "pdhg-tv": ("voxel.iterative.pdhg_tv", "PdhgTv"),
    "one-step": ("voxel.iterative.one_step", "OneStep"),
    "fdk-water": ("voxel.one_channel.water_correction", "FdkWater"),
    "nmar": ("voxel.one_channel.nmar", "Nmar"),
    "gaussian-mono": ("published_methods.splatting.r2_gaussian", "GaussianMono"),
    "ellipsoid": ("published_methods.splatting.x_field", "Ellipsoid"),
    "x-gaussian": ("published_methods.splatting.x_gaussian", "XGaussian"),
    "neural": ("published_methods.neural.naf", "Neural"),
    "sax-nerf": ("published_methods.neural.sax_nerf", "SaxNerf"),
    "polyner": ("published_methods.neural.polyner", "Polyner"),
    "gaussian-poly": ("published_methods.splatting.polychromatic", "GaussianPoly"),
}
ONE_CHANNEL = ("fdk-water", "nmar", "gaussian-poly")  # methods of one channel and a circular orbit
NEED_CURVE = (*ONE_CHANNEL, "polyner")  # methods that need ``--bases curve``
ON_CURVE = ("one-step", *NEED_CURVE)  # methods that take it


def method_named(name: str, iterations: int | None = None, seed: int | None = None) -> "Method | ViewMethod":
    """Return a method with its default settings, but for the number of iterations and the seed.

    Parameters
    ----------
    name : one of `METHODS`
    iterations : number of iterations; None for that of the method
    seed : of random numbers, None for that of the method; without effect where there are none

    Returns
    -------
    the method

    Raises
    ------
    InputError
        When there is no such method, or it does not iterate.
    """
    if name not in METHODS:
        raise InputError(f"there is no method {name}: choose one of {', '.join(METHODS)}")
    module, kind = METHODS[name]
    method = getattr(import_module(f"recon.{module}"), kind)()
    known = {field.name for field in fields(method)}
    if seed is not None and "seed" in known:
        method = replace(method, seed=seed)
    if iterations is None:
        return method
    if "iterations" not in known:
        raise InputError(f"the method {name} has no number of iterations to choose: leave --sweeps out")
    return replace(method, iterations=iterations)
