"""What the compiler needs to be told. Every workaround for XLA stands here, under a name of its kind.

Pinning. XLA on a CPU computes a sum or a product again for every array that needs it: cheap where little is
shared, and many times slower where a long chain is. A pinned value is computed once and kept: it is divided
by a one that XLA cannot see through, and a division is dear enough that XLA keeps its result. (An
optimization barrier is gone by the time it decides that.) Kernels call `pin` on what many later numbers need;
whether it does anything is decided around them, by `with pinning(...)`, and without that it does nothing.
"""

import contextlib
import contextvars
from collections.abc import Callable, Iterator

import jax
import jax.numpy as jnp

from ikjax.core import safe
from ikjax.core.trig import Scalar

Pin = Callable[[Scalar], Scalar]
"""Keeps a value from being computed again."""

_pin: contextvars.ContextVar[Pin | None] = contextvars.ContextVar("pin", default=None)
_agreed: contextvars.ContextVar[Pin | None] = contextvars.ContextVar("agreed", default=None)


def opaque_one(like: jax.Array) -> jax.Array:
    """Ones of the shape and type of `like`, which XLA cannot see through."""
    return jnp.where(like == like, 1, 2).astype(like.dtype)


def divider(like: jax.Array) -> Pin:
    """Pins values by a one of the shape of `like`."""
    one = opaque_one(like)
    # A division by a number that is spread out would become a multiplication, and be done again.
    return lambda x: x / (one if jnp.ndim(x) <= one.ndim else opaque_one(x))


def divider_once(like: jax.Array) -> Pin:
    """As `divider`, but known numbers, and what it returned before, are returned as they are."""
    divide = divider(like)
    done: dict[int, jax.Array] = {}

    def pin(x: Scalar) -> Scalar:
        if not isinstance(x, jax.Array) or id(x) in done:
            return x
        result = divide(x)
        done[id(result)] = result
        return result

    return pin


def pin(x: Scalar) -> Scalar:
    """The value, computed once by the policy of the `pinning` around the caller, if there is any."""
    policy = _pin.get()
    return x if policy is None else policy(x)


@contextlib.contextmanager
def pinning(policy: Pin | None) -> Iterator[None]:
    """While tracing inside: `pin` is `policy`, and nothing where that is None."""
    before = _pin.set(policy)
    try:
        yield
    finally:
        _pin.reset(before)


class AgreedRoots:
    """Square roots that two writings of one kernel must agree on.

    A square root near zero makes half the digits noise, and noise of two roundings would not fit together. So
    the roots are recorded from one writing of the kernel and replayed in the others, in the order in which
    they come up.
    """

    def __init__(self, policy: Pin):
        self._policy = policy
        self._recorded: list[Scalar] = []

    @contextlib.contextmanager
    def recorded(self) -> Iterator[None]:
        """While tracing inside: every root is pinned and remembered."""

        def record(root: Scalar) -> Scalar:
            self._recorded.append(self._policy(root))
            return self._recorded[-1]

        with _agreeing(record):
            yield

    @contextlib.contextmanager
    def replayed(self) -> Iterator[None]:
        """While tracing inside: each root is the one that was recorded in its place.

        Raises:
            RuntimeError: The kernel asked for more roots than were recorded, or for fewer.
        """
        count = 0

        def replay(_) -> Scalar:
            nonlocal count
            count += 1
            if count > len(self._recorded):
                raise RuntimeError(f"the kernel asked for more than the {len(self._recorded)} roots recorded")
            return self._recorded[count - 1]

        with _agreeing(replay):
            yield
        if count != len(self._recorded):
            raise RuntimeError(f"the kernel asked for {count} of the {len(self._recorded)} roots recorded")


@contextlib.contextmanager
def _agreeing(policy: Pin) -> Iterator[None]:
    before = _agreed.set(policy)
    try:
        yield
    finally:
        _agreed.reset(before)


def agreed(x: Scalar) -> Scalar:
    """What many later numbers need and rounding makes uncertain: agreed on between writings, else pinned."""
    policy = _agreed.get()
    return pin(x) if policy is None else policy(x)


def agreed_root(x: Scalar) -> Scalar:
    """A square root, agreed on between writings because rounding makes it uncertain near zero."""
    root, policy = safe.sqrt(x), _agreed.get()
    return root if policy is None else policy(root)
