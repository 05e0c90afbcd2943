"""Both precisions, no silent promotion, and a persistent cache of compiled programs."""

import gc
import os
import pathlib

import jax
import numpy as np
import pytest

ROOT = pathlib.Path(__file__).parent.parent

# Environment variables, because tests start programs of their own.
os.environ["JAX_COMPILATION_CACHE_DIR"] = str(ROOT / ".pytest_cache" / "jax")
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0"

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)


@pytest.fixture(params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request):
    """Each precision in turn."""
    return request.param


@pytest.fixture(
    params=[pytest.param(np.float32, marks=pytest.mark.slow), np.float64], ids=["float32", "float64"]
)
def costly_dtype(request):
    """The same for what compiles for long: float32 only in the slow tests."""
    return request.param


@pytest.fixture
def rng():
    """The same random numbers in every run."""
    return np.random.default_rng(0)


@pytest.fixture(autouse=True)
def modest_memory():
    """Compiled programs are released whenever a process has grown by two gigabytes."""
    yield
    if _size() > MEMORY["limit"]:
        jax.clear_caches()
        gc.collect()
        MEMORY["limit"] = _size() + GROWTH


GROWTH = 2 * 2**30
MEMORY = {"limit": 2 * GROWTH}


def _size() -> int:
    """Resident memory of this process [bytes], where the system tells it; else 0."""
    statm = pathlib.Path("/proc/self/statm")
    return int(statm.read_text().split()[1]) * 4096 if statm.exists() else 0
