"""The decorator of compiled kernels: numba's `njit`, cached on disk, typed as the function that it decorates.

Kernels live in modules of their own that are imported only where they are used, because importing numba costs about
0.3 s and compiling a kernel that is not in the cache costs seconds (`docs/dependencies.md`). Their arguments are int64
and float64 arrays and numbers, so that one signature is compiled and the result is the same on every machine; never
`fastmath`. A division by zero gives inf or nan as in NumPy: Python's exception would be compiled into every division.
"""

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., object])


def compiled(kernel: Kernel) -> Kernel:
    """Compile a function of arrays and numbers when it is first called; the code is kept beside the module.

    numba keeps it in the user's cache folder where the module's own cannot be written; `NUMBA_CACHE_DIR` names another.
    """
    return cast(Kernel, numba.njit(cache=True, error_model="numpy")(kernel))
