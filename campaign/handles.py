"""Objects for methods: handles, which hold no reference to what they stand for, and copies.

A method can follow the attributes, items and closures of every object that it gets. None of these leads to the truth,
to the seed or to a folder of the run: what needs them on behalf of a method is the target of a handle, kept here.
Python cannot hide it from code of the same process that looks into frames of the stack, tracebacks, globals of
functions, the garbage collector, loaded modules or files.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, cast
from weakref import WeakKeyDictionary

import numpy as np

T = TypeVar("T")


class Handle:
    """Stands for a target that is found by the identity of the handle, as long as the handle lives."""

    __slots__ = ("__weakref__",)

    def __init__(self, target: object) -> None:
        _TARGETS[self] = target

    def __reduce__(self) -> str:
        raise TypeError(f"{type(self).__name__} cannot be copied or pickled: it is a handle of this process")


_TARGETS: WeakKeyDictionary[Handle, Any] = WeakKeyDictionary()


def target_of(handle: Handle) -> Any:
    """Return the object behind a handle."""
    return _TARGETS[handle]


def own_copy(value: T) -> T:
    """Copy dataclasses, tuples and arrays, at any depth; other values are returned as they are.

    A method that changes its input, also a frozen one, changes only its copy. Arrays keep their layout, on which the
    last bits of a product may depend, and whether they can be written. Cached properties are not copied.
    """
    if isinstance(value, np.ndarray):
        array = value.copy(order="K")
        array.setflags(write=value.flags.writeable)
        return cast("T", array)
    if isinstance(value, tuple):
        return cast("T", tuple(map(own_copy, value)))
    if is_dataclass(value) and not isinstance(value, type):
        copy = object.__new__(type(value))
        for field in fields(value):
            object.__setattr__(copy, field.name, own_copy(getattr(value, field.name)))
        return copy
    return value
