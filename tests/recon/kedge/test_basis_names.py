"""Basis functions as users ask for them."""

import pytest

from recon.kedge.basis_names import OnCurve, bases_text, parse_bases


@pytest.mark.parametrize("asked", [2, ("photoelectric", "compton"), OnCurve(), OnCurve(("water", "Ti"))])
def test_bases_are_written_as_they_are_read(asked):
    assert parse_bases(bases_text(asked)) == asked
