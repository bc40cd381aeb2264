"""JSON of numbers as numpy has them."""

import json
from pathlib import Path

import numpy as np
import pytest

from phantomgen.runtime.plain_json import to_json


def test_numbers_of_numpy_are_numbers_and_nan_is_null():
    content = {
        "bool": np.bool_(True), "float": np.float32(0.5), "int": np.int64(3), "nan": np.nan, "infinite": -np.inf,
        "array": np.array([[1.0, np.nan]]), "tuple": (np.float64(1.5), None, "x"), 3: [np.array(2)], "path": Path("a"),
    }  # fmt: skip
    assert json.loads(to_json(content)) == {
        "bool": True, "float": 0.5, "int": 3, "nan": None, "infinite": None, "array": [[1.0, None]],
        "tuple": [1.5, None, "x"], "3": [2], "path": "a",
    }  # fmt: skip


def test_what_has_no_counterpart_is_refused():
    with pytest.raises(TypeError, match="type set has no counterpart"):
        to_json({"a": {1, 2}})
