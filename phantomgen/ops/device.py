"""Decorators of numba functions that only other numba functions call.

`inlined` puts the body into its callers, which also spares them the counting of references to arrays; `called` leaves
it a function. None can be called from Python: without the bridges, a quarter less time to compile. Sums of a
`reordered` function, which is inlined, go by the vectors of the machine, whatever the number of threads: their last
digits depend on the kind of processor.
"""

from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

inlined = njit(forceinline=True, **_OPTIONS)
called = njit(**_OPTIONS)
reordered = njit(forceinline=True, fastmath={"reassoc", "nsz", "contract"}, **_OPTIONS)
