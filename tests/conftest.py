"""Both precisions, no silent promotion, and compiled programs kept from run to run."""

import pathlib

import jax
import numpy as np
import pytest

ROOT = pathlib.Path(__file__).parent.parent
STATM = pathlib.Path("/proc/self/statm").exists()

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", str(ROOT / ".pytest_cache" / "jax"))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.5)


@pytest.fixture(params=[np.float32, np.float64], ids=["float32", "float64"])
def dtype(request):
    """Each precision in turn."""
    return request.param


@pytest.fixture
def rng():
    """The same random numbers in every run."""
    return np.random.default_rng(0)


@pytest.fixture(autouse=True)
def modest_memory():
    """Compiled programs are let go of when a process has grown beyond three gigabytes."""
    yield
    pages = int(pathlib.Path("/proc/self/statm").read_text().split()[1]) if STATM else 0
    if pages * 4096 > 3 * 2**30:
        jax.clear_caches()
