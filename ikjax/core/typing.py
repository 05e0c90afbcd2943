"""Types of the arguments of public functions."""

from collections.abc import Sequence
from typing import Any

from jax.typing import ArrayLike

ArrayInput = ArrayLike | Sequence[Any]
"""What `jnp.asarray` takes: a jax or numpy array, a number, or nested lists of numbers.

`jax.typing.ArrayLike` leaves lists out. Here they are welcome at the door: a table of an arm is typed in.
"""
