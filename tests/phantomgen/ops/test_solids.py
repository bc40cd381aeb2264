"""Bounds of the terms that solids consist of."""

import numpy as np

from phantomgen.ops.primitives import BALL, BOX, HALFSPACE
from phantomgen.ops.solids import Solids


def test_terms_are_bounded_by_what_they_lie_inside():
    """A ball and a box that a plane cuts, less another ball; then a ball alone."""
    solids = Solids(
        kinds=np.array([BALL, BOX, HALFSPACE, BALL, BALL]),
        locals_=np.zeros((5, 3, 4)),
        materials=np.zeros(5, np.int64),
        tubes=np.zeros(5),
        owners=np.array([0, 0, 0, 0, 4]),
        terms=np.array([0, 0, 0, 0, 4]),
        inside=np.array([True, True, True, False, True]),
        meshes=np.full(5, -1),
    )
    own = np.array([[0.0, 4, -9, 3], [1, 7, -2, 8], [-np.inf, np.inf, -np.inf, np.inf], [2, 3, 0, 1], [5, 6, 7, 8]])
    np.testing.assert_array_equal(solids.term_bounds(own), [[1, 4, -2, 3]] * 4 + [[5, 6, 7, 8]])
    np.testing.assert_array_equal(solids.term_bounds(own[:, :2]), [[1, 4]] * 4 + [[5, 6]])
