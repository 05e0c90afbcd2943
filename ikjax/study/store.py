"""Maps on disk: a zarr v3 group written by tensorstore, with a checksum on every chunk.

Storey: study. Needs the extra `sweep`. A flipped bit or a missing chunk is an error when it is
read, never a wrong number. The group opens in zarr and xarray as well.
"""

import dataclasses
import hashlib
import json
import math
import pathlib
import shutil

import numpy as np

from ikjax.arm.arm import Arm

SCHEMA = 1
"""Version of the layout; a reader refuses any other."""

_CHUNK = 64


def _tensorstore():
    try:
        import tensorstore
    except ImportError as error:
        raise ImportError("maps on disk need tensorstore: pip install 'ikjax[sweep]'") from error
    return tensorstore


def _array_spec(path: pathlib.Path, name: str) -> dict:
    return {
        "driver": "zarr3",
        "kvstore": {"driver": "file", "path": f"{path / name}/", "file_io_sync": True},
        # A chunk that is not there is lost data here, not a block of zeros.
        "fill_missing_data_reads": False,
        "store_data_equal_to_fill_value": True,
    }


def fingerprint(spec: dict) -> str:
    """What tells one study from another: a hash of its canonical JSON."""
    return hashlib.sha256(json.dumps(spec, sort_keys=True).encode()).hexdigest()[:16]


def write(path, spec: dict, arrays: dict[str, np.ndarray]) -> None:
    """Write a group of arrays with a spec in its attributes, replacing an older map."""
    ts = _tensorstore()
    path = pathlib.Path(path).absolute()
    if path.exists():
        if not (path / "zarr.json").is_file():
            raise FileExistsError(f"{path} exists and is no map; it is left alone")
        shutil.rmtree(path)
    path.mkdir(parents=True)
    for name, array in arrays.items():
        chunk = [min(_CHUNK, size) for size in array.shape]
        metadata = {
            "shape": list(array.shape),
            "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
            "data_type": array.dtype.name,
            "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}, {"name": "crc32c"}],
        }
        dataset = ts.open({**_array_spec(path, name), "metadata": metadata, "create": True}).result()
        dataset.write(array).result()
    attributes = {"ikjax_schema": SCHEMA, "fingerprint": fingerprint(spec), "spec": spec}
    group = {"zarr_format": 3, "node_type": "group", "attributes": attributes}
    (path / "zarr.json").write_text(json.dumps(group, indent=1))


def read(path, names: tuple[str, ...]) -> tuple[dict, dict[str, np.ndarray]]:
    """The spec and the arrays of a group.

    Raises:
        ValueError: No map there, of another schema, changed by hand, or damaged.
    """
    ts = _tensorstore()
    path = pathlib.Path(path).absolute()
    try:
        attributes = json.loads((path / "zarr.json").read_text())["attributes"]
        schema, spec = attributes["ikjax_schema"], attributes["spec"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} holds no ikjax map") from error
    if schema != SCHEMA:
        raise ValueError(f"{path} has schema {schema}, this version reads schema {SCHEMA}")
    if attributes.get("fingerprint") != fingerprint(spec):
        raise ValueError(
            f"{path}: the spec has fingerprint {fingerprint(spec)}, "
            f"the map was made with {attributes.get('fingerprint')}"
        )
    arrays = {}
    for name in names:
        try:
            arrays[name] = np.asarray(ts.open(_array_spec(path, name), open=True).result().read().result())
        except ValueError as error:  # tensorstore raises it for lost and for damaged data
            raise ValueError(f"{path}: {name} is damaged: {str(error)[:200]}") from error
    return spec, arrays


def arm_to_spec(arm: Arm) -> dict:
    """An arm as JSON: lists of numbers, infinities as null."""
    columns = {name: np.asarray(getattr(arm, name), float).tolist() for name in _LEAVES}
    columns["limits"] = [[x if math.isfinite(x) else None for x in pair] for pair in columns["limits"]]
    return {"name": arm.name, "kinds": arm.kinds, **{key: getattr(arm, key) for key in _FACTS}, **columns}


def arm_from_spec(spec: dict) -> Arm:
    """The arm of `arm_to_spec`, recognised anew."""
    limits = [[-math.inf if lo is None else lo, math.inf if hi is None else hi] for lo, hi in spec["limits"]]
    table = {name: spec[name] for name in _LEAVES} | {"limits": limits}
    # Leaves that were rounded to float32 are judged as such: the family is the one that was stored.
    arm = Arm.from_dh(**table, kinds=spec["kinds"], name=spec["name"], convention="standard")
    return dataclasses.replace(
        arm,
        family=spec["family"],
        signs=tuple(spec["signs"]),
        branches=tuple(spec["branches"]),
        task=spec["task"],
    )


_FACTS = ("family", "signs", "branches", "task")
_LEAVES = ("a", "alpha", "d", "theta", "base", "tool", "limits")
