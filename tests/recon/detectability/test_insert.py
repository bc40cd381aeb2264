"""Inserts: how they are written, which voxels they are, and volumes without them."""

import numpy as np
import pytest

from phantomgen.geometry.orbits import spread_angles
from phantomgen.geometry.panel import Panel
from phantomgen.geometry.poses import Geometry
from phantomgen.geometry.voxel_grid import Grid
from recon.detectability.insert import Insert, WithoutInsert
from recon.voxel.model import Voxels
from spectra.errors import InputError

GRID = Grid.cube(32, 64.0)


@pytest.mark.parametrize("text", ["1,2,3,4", "-1.5,0,0,8,40", "0,0,0,0.25"])
def test_an_insert_is_written_as_it_is_read(text):
    assert str(Insert.parse(text)) == text


@pytest.mark.parametrize(
    "text", ["", "1,2,3", "1,2,3,4,5,6", "a,2,3,4", "1,2,3,0", "1,2,3,-4", "1,2,3,4,0", "nan,0,0,1"]
)
def test_other_texts_are_refused_in_one_sentence(text):
    with pytest.raises(InputError, match=r"an insert is X,Y,Z,RADIUS for a ball or .* got"):
        Insert.parse(text)


@pytest.mark.parametrize(("text", "first", "last"), [("0,0,0,8,20", -9, 9), ("0,0,5,8", 1, 9), ("0,0,7,0.1", 7, 7)])
def test_its_slices_are_those_of_a_rod_and_the_middle_of_a_ball(text, first, last):
    z = GRID.axis("z")[Insert.parse(text).layers(GRID)]
    assert z[[0, -1]] == pytest.approx([first, last])


def test_its_window_is_a_square_around_its_centre():
    insert = Insert.parse("3,-5,0,4")
    rows, columns, centre = insert.window(GRID)
    y, x = GRID.axis("y")[rows], GRID.axis("x")[columns]
    assert len(x) == len(y) == 25
    assert (y[12], x[12]) == pytest.approx((-5, 3))
    assert centre == pytest.approx((12, 12))


@pytest.mark.parametrize("text", ["0,0,60,8", "30,0,0,8", "0,-29,0,4"])
def test_an_insert_at_or_beyond_the_edge_is_refused(text):
    insert = Insert.parse(text)
    place = insert.layers if insert.center[2] else insert.window
    with pytest.raises(InputError, match="insert at"):
        place(GRID)


def test_without_the_insert_its_place_is_filled_by_its_surroundings():
    insert = Insert.parse("3,-5,0,6,40")
    volumes = np.full((2, *GRID.shape), 0.02, np.float32)
    volumes[:, insert.region(GRID)] += [[0.005], [-0.001]]
    excess = insert.excess(volumes, GRID)
    np.testing.assert_allclose(volumes - excess, 0.02, rtol=1e-6)
    assert np.array_equal(excess[0] != 0, insert.region(GRID))
    whole = Voxels(volumes, GRID, ("photoelectric", "compton"))
    without = WithoutInsert(whole, Voxels(excess, GRID, whole.basis_names))
    geometry = Geometry.circular(200, 300, spread_angles(3, 0), Panel(8, 20, 4.0))
    filled = Voxels(volumes - excess, GRID, whole.basis_names).line_integrals(geometry)
    np.testing.assert_allclose(without.line_integrals(geometry), filled, atol=2e-6)
    assert without.basis_names == whole.basis_names
