"""Decorator for compiled kernels: numba's `njit`, cached on disk, typed like the decorated function.

numba is imported at the first call of a kernel, because the import takes about 0.3 s and most commands call none
(`docs/internals/dependencies.md`). The arguments of kernels are numbers and arrays of int64 and float64: one signature
is compiled, and the result is the same on every machine. Never use `fastmath`.

A kernel calls only kernels of the same file. numba copies the called code into the cached code of the caller, and
considers that code current as long as the caller's file is unchanged. A change in another file would go unnoticed.

The first kernel of a process that must be compiled causes a warning of this module's logger.
"""

import functools
import logging
import threading
from collections.abc import Callable
from typing import Any, TypeVar, cast

log = logging.getLogger(__name__)
log.addHandler(logging.NullHandler())  # without a handler, Python would print the warning on stderr

Kernel = TypeVar("Kernel", bound=Callable[..., object])

_lock = threading.Lock()
_waiting: dict[str, list[Callable[..., Any]]] = {}
"""Kernels that are not compiled yet, by module."""
_at_first: list[Callable[[], None]] = []
"""Functions that are called at the first compilation."""


def compiled(kernel: Kernel) -> Kernel:
    """Return a module-level function that is compiled by numba at its first call.

    The code is cached next to the module, or in the user's cache folder where that is not writable; `NUMBA_CACHE_DIR`
    names another folder. The wrapper for callers in C is omitted, which saves a twelfth of the compile time. Kernels
    release Python's global lock.
    """
    _waiting.setdefault(kernel.__module__, []).append(kernel)

    @functools.wraps(kernel)
    def call(*arguments: object) -> object:
        _replace_by_dispatchers(kernel.__module__)
        return kernel.__globals__[kernel.__name__](*arguments)

    return cast(Kernel, call)


def call_at_first_compilation(function: Callable[[], None]) -> None:
    """Call a function when this process compiles its first kernel."""
    if function not in _at_first:
        _at_first.append(function)


def _replace_by_dispatchers(module: str) -> None:
    """Replace the kernels of a module by numba's dispatchers, so that they find each other when they are compiled."""
    with _lock:
        if not (kernels := _waiting.get(module)):
            return
        import numba

        _announce_compilation()
        for kernel in kernels:
            kernel.__globals__[kernel.__name__] = numba.njit(cache=True, no_cfunc_wrapper=True, nogil=True)(kernel)
        del _waiting[module]


@functools.cache
def _announce_compilation() -> None:
    """Warn once when numba compiles a function."""
    from numba.core import event

    class Listener(event.Listener):  # type: ignore[misc] # numba ships no types
        is_announced = False

        def on_start(self, event: object) -> None:
            if not self.is_announced:
                self.is_announced = True
                log.warning("compiling inner loops, once for all later runs: this takes some seconds")
                for function in _at_first:
                    function()

        def on_end(self, event: object) -> None:
            pass

    event.register("numba:compile", Listener())
