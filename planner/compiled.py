"""The decorator of compiled kernels: numba's `njit`, cached on disk, typed as the function that it decorates.

Kernels live in modules of their own that are imported only where they are used, because importing numba costs about
0.3 s and compiling a kernel that is not in the cache costs seconds (`docs/internals/dependencies.md`). Their
arguments are int64 and float64 arrays and numbers, so that one signature is compiled and the result is the same on
every machine; never `fastmath`.

A kernel calls only kernels of its own file. numba builds what is called into the stored code of the caller, and takes
that code for current as long as the caller's file is unchanged: a kernel of another file could change unnoticed.

The first kernel of a process that is not in the cache is told as a warning of this module's logger.
"""

import logging
from collections.abc import Callable
from typing import TypeVar, cast

import numba
from numba.core import event

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a handler, Python would print the warning on stderr

Kernel = TypeVar("Kernel", bound=Callable[..., object])


class _Telling(event.Listener):  # type: ignore[misc] # numba ships no types
    told = False

    def on_start(self, event: object) -> None:
        if not self.told:
            log.warning("inner loops are compiled, once for all runs to come: this takes some seconds")
        self.told = True

    def on_end(self, event: object) -> None:
        pass


event.register("numba:compile", _Telling())


def compiled(kernel: Kernel) -> Kernel:
    """Compile a function of arrays and numbers when it is first called; the code is kept beside the module.

    Without the wrapper for callers in C, whom nobody is, a twelfth of the time is saved.

    numba keeps it in the user's cache folder where the module's own cannot be written; `NUMBA_CACHE_DIR` names another.
    """
    return cast(Kernel, numba.njit(cache=True, no_cfunc_wrapper=True)(kernel))
