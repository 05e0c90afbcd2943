"""The catalogue's arms in ssik, which describes and solves them independently."""

import importlib

import numpy as np
import pytest

SSIK = {
    "irb120": "abb.irb120_ik",
    "kr6_r900": "kuka.kr6_r900_ik",
    "lrmate200id": "fanuc.lrmate200id_ik",
    "rx160": "staubli.rx160_ik",
    "puma560": "unimation.puma560_ik",
    "ur3e": "universal_robots.ur3e_ik",
    "ur5": "universal_robots.ur5_ik",
    "ur5e": "universal_robots.ur5e_ik",
    "ur10e": "universal_robots.ur10e_ik",
}


def ssik(name):
    """ssik's module of an arm; the test is skipped where the package is not installed."""
    pytest.importorskip("ssik")
    return importlib.import_module(f"ssik.prebuilt.{SSIK[name]}")


def ssik_base(name) -> np.ndarray:
    """Our base in the frame of ssik's: for Universal Robots they differ by half a turn."""
    return np.diag([-1.0, -1, 1, 1]) if name.startswith("ur") else np.eye(4)
