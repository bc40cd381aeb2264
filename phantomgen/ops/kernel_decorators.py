"""Decorators of numba functions that only other numba functions call.

`inlined` puts the body into its callers, which also spares them the counting of references to arrays; `called` leaves
it a function. None can be called from Python: without the bridges, a quarter less time to compile. Sums of a
`reordered` function, which is inlined, go by the vectors of the machine, whatever the number of threads: their last
digits depend on the kind of processor. A kernel that reorders sums, by ``fastmath``, calls functions that name their
own: numba compiles others once in a process, with the flags of the kernel that happens to come first.
"""

from typing import Any

from numba import njit

REORDER: set[str] = {"reassoc", "nsz", "contract"}
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

inlined = njit(forceinline=True, **_OPTIONS)
called = njit(**_OPTIONS)
reordered = njit(forceinline=True, fastmath=REORDER, **_OPTIONS)
