"""Decorators of numba functions that only other numba functions call.

`inlined` puts the body into its callers, which also spares them the counting of references to arrays; `called` leaves
it a function. Neither can be called from Python: without the bridges, a quarter less time to compile.
"""

from typing import Any

from numba import njit

_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}

inlined = njit(forceinline=True, **_OPTIONS)
called = njit(**_OPTIONS)
