"""The energy of a K edge in a scene file: one key, and the name that it had before."""

import pytest
from pydantic import ValidationError

from phantomgen.scene.schema import EdgeFunctionModel, json_schema


def test_the_earlier_name_is_read_and_only_the_present_one_documented():
    old, new = (EdgeFunctionModel.model_validate({"type": "step", key: 63.3}) for key in ("edge", "edge_energy"))
    assert old == new
    assert old.model_dump()["edge_energy"] == 63.3
    assert set(json_schema()["$defs"]["EdgeFunctionModel"]["properties"]) == {"type", "edge_energy", "element", "width"}


def test_both_names_at_once_are_refused():
    with pytest.raises(ValidationError, match="edge is the earlier name of edge_energy: give one of them"):
        EdgeFunctionModel.model_validate({"type": "step", "edge": 63.3, "edge_energy": 50.2})
