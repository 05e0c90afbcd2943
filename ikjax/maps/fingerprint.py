"""What a function of the user's computes, as a hash: its program, and every number that the program holds.

jax prints a program without the constants of programs within it (an inner `jit`, a branch of
`cond`, the body of a loop), and long arrays without their middle; so all numbers are hashed beside the text.
"""

import hashlib
import re
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

OUTSIDE = ("pure_callback", "io_callback")
"""Steps that call Python: what they do there is nowhere in the program."""


def traced(name: str, function: Callable, *inputs: Any) -> tuple[str, list[tuple[int, ...]]]:
    """A hash of what a function does with arrays like the inputs, and the shapes of what it returns.

    The function is traced anew at each call, so that what it reads from outside (a global, the state of an
    object) counts as it is now.

    Raises:
        ValueError: The function does something else at every trace, or calls Python from within its program.
    """
    # A function of its own each time, because jax remembers the traces of functions that it has seen.
    one, other = (jax.make_jaxpr(lambda *arrays: function(*arrays))(*inputs) for _ in range(2))
    code = _code(name, one)
    if code != _code(name, other):
        raise ValueError(
            f"{name} must do the same whenever it is called: its program changes from trace to trace"
        )
    return code, [aval.shape for aval in one.out_avals]


def _code(name: str, program: ClosedJaxpr) -> str:
    # Where functions lie in memory is no part of a program, and neither are the colors of a terminal.
    text = re.sub(r"0x[0-9a-f]+", "", program.jaxpr.pretty_print(source_info=False, use_color=False))
    if outside := re.search(rf"\b({'|'.join(OUTSIDE)})\[", text):
        raise ValueError(f"{name} must be made by jax alone, got {outside[1]}, which calls Python")
    code = hashlib.sha256(text.encode())
    for number in _held(program):
        array = np.asarray(number)
        code.update(f"{array.dtype}{array.shape}".encode() + array.tobytes())
    return code.hexdigest()[:16]


def _held(part: Any) -> Iterator[Any]:
    """Every number of a program, in the order of its steps."""
    if isinstance(part, ClosedJaxpr):
        yield from _held(part.consts)
        yield from _held(part.jaxpr)
    elif isinstance(part, Jaxpr):
        for step in part.eqns:
            yield from _held(step.invars)
            yield from _held(step.params)
        yield from _held(part.outvars)
    elif isinstance(part, Literal):
        yield part.val
    elif isinstance(part, dict):
        yield from _held([part[key] for key in sorted(part)])
    elif isinstance(part, list | tuple):
        for each in part:
            yield from _held(each)
    elif isinstance(part, jax.Array) and jax.dtypes.issubdtype(part.dtype, jax.dtypes.prng_key):
        yield jax.random.key_data(part)
    elif (hasattr(part, "dtype") and hasattr(part, "tobytes")) or isinstance(part, jax.Array):
        yield part
