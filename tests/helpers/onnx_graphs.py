"""Small ONNX models, written as protocol buffers without the package onnx: the fields of onnx.proto that they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Attribute = int | float | Sequence[int] | np.ndarray
_FLOAT, _INT64 = 1, 7
_TYPES = {np.dtype(np.float32): _FLOAT, np.dtype(np.int64): _INT64}


def _varint(value: int) -> bytes:
    found = bytearray()
    value &= (1 << 64) - 1
    while value > 127:
        found.append(value & 127 | 128)
        value >>= 7
    return bytes([*found, value])


def _field(number: int, value: int | str | bytes) -> bytes:
    """Encode a field: an integer as a varint, text and messages with their length."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    value = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _tensor(values: np.ndarray, name: str = "", file: str = "") -> bytes:
    """Encode an array; with ``file`` its content is in that file, beside the model."""
    told = b"".join(_field(1, size) for size in values.shape) + _field(2, _TYPES[values.dtype]) + _field(8, name)
    if file:
        return told + _field(13, _field(1, "location") + _field(2, file)) + _field(14, 1)
    return told + _field(9, values.tobytes())


def _attribute(name: str, value: Attribute) -> bytes:
    if isinstance(value, np.ndarray):
        return _field(1, name) + _field(5, _tensor(value)) + _field(20, 4)
    if isinstance(value, int):
        return _field(1, name) + _field(3, value) + _field(20, 2)
    return _field(1, name) + b"".join(_field(8, one) for one in value) + _field(20, 7)


def node(kind: str, inputs: str, output: str, **attributes: Attribute) -> bytes:
    """Encode a node; the names of its inputs are separated by blanks."""
    told = b"".join(_field(1, one) for one in inputs.split()) + _field(2, output) + _field(4, kind)
    return told + b"".join(_field(5, _attribute(name, value)) for name, value in attributes.items())


def _value(name: str, shape: Sequence[int | str], kind: int = _FLOAT) -> bytes:
    dims = b"".join(_field(1, _field(1 if isinstance(one, int) else 2, one)) for one in shape)
    return _field(1, name) + _field(2, _field(1, _field(1, kind) + _field(2, dims)))


def write_model(
    path: Path,
    nodes: Sequence[bytes],
    input_shape: Sequence[int | str],
    outputs: Mapping[str, Sequence[int | str]],
    constants: Mapping[str, np.ndarray] | None = None,
    input_type: int = _FLOAT,
    outside: str = "",
) -> Path:
    """Write a model whose input is ``x``; outputs that are named ``labels`` are integers.

    The constant ``outside`` is written to a file of that name beside the model.
    """
    parts = [_field(1, one) for one in nodes] + [_field(2, "graph")]
    for name, values in (constants or {}).items():
        parts.append(_field(5, _tensor(values, name, name if name == outside else "")))
        if name == outside:
            (path.parent / name).write_bytes(values.tobytes())
    parts += [_field(11, _value("x", input_shape, input_type))]
    kinds = {name: _INT64 if name == "labels" else _FLOAT for name in outputs}
    parts += [_field(12, _value(name, shape, kinds[name])) for name, shape in outputs.items()]
    path.write_bytes(_field(1, 8) + _field(7, b"".join(parts)) + _field(8, _field(1, "") + _field(2, 13)))
    return path
