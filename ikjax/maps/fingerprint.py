"""A hash of what a user's function computes: of its program, and of every constant of the program.

jax prints a program without the constants of programs within it (an inner `jit`, a branch of `cond`, the body
of a loop), and long arrays without their middle. So all constants are hashed beside the text.
"""

import hashlib
import re
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

CALLBACKS = ("pure_callback", "io_callback")
"""Operations that call Python: what they do is not part of the program."""


def program_hash(name: str, function: Callable, *inputs: Any) -> tuple[str, list[tuple[int, ...]]]:
    """A hash of what a function does with arrays like the inputs, and the shapes of what it returns.

    The function is traced anew at each call, so values that it reads from outside (a global, the state of an
    object) count as they are now.

    Args:
        name: Of the function, for messages.
        function: From the inputs to a tree of arrays.
        *inputs: Trees of arrays.

    Returns:
        The first 16 digits of a SHA-256, and the shape of each returned array.

    Raises:
        ValueError: The program changes from trace to trace, or calls Python.
    """
    # A new lambda each time, because jax caches the traces of functions that it has seen.
    one, other = (jax.make_jaxpr(lambda *arrays: function(*arrays))(*inputs) for _ in range(2))
    code = _hash_of(name, one)
    if code != _hash_of(name, other):
        raise ValueError(
            f"{name} must do the same whenever it is called: its program changes from trace to trace"
        )
    return code, [aval.shape for aval in one.out_avals]


def _hash_of(name: str, program: ClosedJaxpr) -> str:
    # Addresses of functions in memory are no part of a program, nor are the colors of a terminal.
    text = re.sub(r"0x[0-9a-f]+", "", program.jaxpr.pretty_print(source_info=False, use_color=False))
    if callback := re.search(rf"\b({'|'.join(CALLBACKS)})\[", text):
        raise ValueError(f"{name} must be made by jax alone, got {callback[1]}, which calls Python")
    code = hashlib.sha256(text.encode())
    for number in _constants(program):
        array = np.asarray(number)
        code.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return code.hexdigest()[:16]


def _constants(part: Any) -> Iterator[Any]:
    """Every constant of a program, in the order of its operations."""
    if isinstance(part, ClosedJaxpr | Jaxpr):
        # One class since jax 0.12, whose `jaxpr` is itself; before, only a closed one had constants.
        yield from _constants(getattr(part, "consts", ()))
        program = getattr(part, "jaxpr", part)
        for equation in program.eqns:
            yield from _constants(equation.invars)
            yield from _constants(equation.params)
        yield from _constants(program.outvars)
    elif isinstance(part, Literal):
        yield part.val
    elif isinstance(part, dict):
        yield from _constants([part[key] for key in sorted(part)])
    elif isinstance(part, list | tuple):
        for each in part:
            yield from _constants(each)
    elif isinstance(part, jax.Array) and jax.dtypes.issubdtype(part.dtype, jax.dtypes.prng_key):
        yield jax.random.key_data(part)
    elif (hasattr(part, "dtype") and hasattr(part, "tobytes")) or isinstance(part, jax.Array):
        yield part
