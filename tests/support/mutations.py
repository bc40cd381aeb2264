"""Strategies of hypothesis that spoil scenes, bytes and arrays."""

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
from hypothesis import strategies as st

# Values that a key, an option or a field does not expect.
HOSTILE = (
    None, True, 0, -1, 3, 2.5, 1e-300, 1e300, -1e9, 10**30, float("nan"), float("inf"), "", "x", "1e9", "../..", "\x00",
    "é" * 300, [], {}, [0, 0, 0], [1, 2], [[1]], {"x": 1}, {"type": "sphere"}, {"uniform": [1, 0]}, [None] * 3,
)  # fmt: skip
OPTIONS = (
    "", "0", "-1", "1", "2.5", "nan", "inf", "-inf", "1e300", "1e-300", "9" * 30, "x", "a=b", "=", "/", ".", "..", "\t",
    "a,b", ",", "1:2", "63.3", "q" * 5000, "é", "--", "{}", "[1, 2]", "geometry.views=0", "none", "auto",
)  # fmt: skip


def places(node: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths to all values of a nested document."""
    entries = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in entries:
        yield (*path, key)
        yield from places(value, (*path, key))


@st.composite
def spoiled_documents(draw: st.DrawFn, documents: tuple[dict, ...]) -> dict:
    """One of the documents with one to three values replaced, removed, renamed or taken from another place."""
    document = copy.deepcopy(draw(st.sampled_from(documents)))
    for _ in range(draw(st.integers(1, 3))):
        paths = list(places(document))
        if not paths:
            break
        *above, key = draw(st.sampled_from(paths))
        holder = document
        for step in above:
            holder = holder[step]
        action = draw(st.sampled_from(("replace", "replace", "scale", "remove", "rename", "copy")))
        if action == "remove":
            del holder[key]
        elif action == "rename" and isinstance(holder, dict):
            holder[draw(st.sampled_from(("x", "type", f"{key}s", 7)))] = holder.pop(key)
        elif action == "scale" and isinstance(holder[key], int | float):
            holder[key] = holder[key] * draw(st.sampled_from((0, -1, 1e-6, 1e-3, 1e3, 1e6, 1e12)))
        elif action == "copy":
            value = document
            for step in draw(st.sampled_from(paths)):
                value = value[step]
            holder[key] = copy.deepcopy(value)
        else:
            holder[key] = copy.deepcopy(draw(st.sampled_from(HOSTILE)))
    return document


@st.composite
def spoiled_bytes(draw: st.DrawFn, samples: tuple[bytes, ...]) -> bytes:
    """One of the samples with bytes changed, removed, doubled or cut off."""
    content = bytearray(draw(st.sampled_from(samples)))
    for _ in range(draw(st.integers(1, 4))):
        if not content:
            break
        head = draw(st.booleans())  # most of what a reader decides on stands at the beginning
        at = draw(st.integers(0, min(len(content), 400) - 1 if head else len(content) - 1))
        action = draw(st.sampled_from(("change", "change", "change", "cut", "remove", "double", "digit")))
        if action == "change":
            content[at] = draw(st.integers(0, 255))
        elif action == "digit":
            content[at : at + 1] = draw(st.sampled_from((b"9", b"-", b"nan", b"1e300", b"99999999", b" ", b"\n")))
        elif action == "cut":
            del content[at:]
        else:
            length = draw(st.integers(1, 40))
            content[at : at + length] = content[at : at + length] * (2 if action == "double" else 0)
    return bytes(content)


def spoiled_array(draw: st.DrawFn, array: np.ndarray) -> Any:
    """Another type, another shape, or impossible values."""
    action = draw(st.sampled_from(("value", "value", "shape", "type", "empty", "text", "scalar")))
    if action == "value" and array.size and array.dtype.kind in "iuf":
        changed = array.copy()
        values = (0, 1, -1, 1e30, np.nan, np.inf) if array.dtype.kind == "f" else (0, 1, np.iinfo(array.dtype).max)
        value = draw(st.sampled_from(values))
        if draw(st.booleans()):
            changed[...] = value
        else:
            changed.flat[draw(st.integers(0, array.size - 1))] = value
        return changed
    if action == "shape" and array.ndim:
        return array[: draw(st.integers(0, len(array)))] if draw(st.booleans()) else array[None]
    if action == "type":
        kind = draw(st.sampled_from(("i1", "f2", "f8", "c16", "?")))
        return np.zeros(array.shape, kind)
    return {"empty": np.zeros((0,)), "text": "x", "scalar": 1.0}.get(action, np.zeros((1,)))
