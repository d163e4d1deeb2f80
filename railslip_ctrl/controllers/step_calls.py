"""Calls a user's step function from the compiled simulation, which need not be compiled anew for each function."""

from __future__ import annotations

import ctypes
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

STEP = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_double, ctypes.c_double, ctypes.c_void_p)
"""C type of a step: torque (N*m) from time (s), train speed (m/s), wheel speed (rad/s) and address of the state."""


def address_of(step: Any) -> int:
    """Return the address of `step`, a function of the type `STEP`, which the caller must keep alive."""
    return ctypes.cast(step, ctypes.c_void_p).value or 0


def call_step(address: float, t: float, v: float, omega: float, x: Any) -> float:
    """Return the torque, N*m, of the step at `address` for time, train speed, wheel speed and state in SI."""
    return float(STEP(int(address))(t, v, omega, x.ctypes.data))


@intrinsic  # type: ignore[untyped-decorator]
def _call(typing_context: Any, address: Any, t: Any, v: Any, omega: Any, x: Any) -> Any:
    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number, word = ir.DoubleType(), arguments[0].type
        kind = ir.FunctionType(number, [number, number, number, word])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.float64(types.uintp, types.float64, types.float64, types.float64, types.uintp), code


@overload(call_step)
def _compiled_call(address, t, v, omega, x):  # type: ignore[no-untyped-def]
    return lambda address, t, v, omega, x: _call(types.uintp(address), t, v, omega, types.uintp(x.ctypes.data))
