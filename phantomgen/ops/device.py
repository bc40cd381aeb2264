"""Decorators of numba functions that only other numba functions call.

`inlined` puts the body into its callers, which also spares them the counting of references to arrays; `called` leaves it
a function. Neither can be called from Python: leaving the bridges out saves a quarter of the time to compile.
"""

from numba import njit

inlined = njit(forceinline=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
called = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
