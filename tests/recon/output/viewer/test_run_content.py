"""What a look at a run shows, in numbers: volumes side by side, surfaces and ellipsoids."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from support.toy_run import COEFFICIENTS, GRID, NAMES, boxes, content, gaussians

from phantomgen.display.viewer.content import materials
from recon.output.viewer.content import RunContent
from recon.output.viewer.ellipsoid_markers import ellipsoids, masses
from recon.output.viewer.output import chosen_bases
from recon.output.viewer.surfaces import level_bodies, nearest_materials, parse_levels, surfaces, usual_levels
from spectra.errors import InputError


def test_a_difference_is_result_minus_truth():
    shown = content()
    assert shown.difference(2)[8, 8, 11] == pytest.approx(-0.012)
    assert np.count_nonzero(shown.difference(0)) == 0
    square = 8 * 4 * 3 * 0.012**2 / 16**3
    psnr = 10 * np.log10(0.024**2 / square)
    assert shown.errors(2) == f"PSNR {psnr:.1f} dB, rms {square**0.5:.2g} 1/mm"
    assert shown.difference_scale(2) >= 0.012
    assert shown.scale(2)[0] == pytest.approx(0.024, abs=1.1e-3)


def test_what_is_filled_holds_the_object_and_what_the_result_adds():
    shown = content()
    inside = np.zeros(GRID.shape, bool)
    inside[2:14, 2:14, 2:14] = True
    assert np.array_equal(shown.filled, inside)
    more = shown.result.copy()
    more[1, 0, 0, 0] = 0.01
    assert replace(shown, result=more).filled[0, 0, 0]


def test_a_basis_that_one_side_lacks_is_zero_there():
    fewer = content(names=("photoelectric", "compton"))
    assert fewer.basis_names == NAMES
    assert not fewer.result[2].any()
    other = RunContent.of("other", GRID, ("compton", "kedge_50.2"), content().result[1:], boxes(), None)
    assert other.basis_names == (*NAMES, "kedge_50.2")
    assert not other.true[3].any()
    assert np.array_equal(other.result[1], content().result[1])
    assert other.scale(3)[0] >= 0.012


def test_a_run_without_truth_has_no_difference():
    with pytest.raises(InputError, match="toy has no truth to compare with"):
        content(truth=False).difference(0)


def test_planes_and_bases_that_are_not_there_are_refused():
    with pytest.raises(InputError, match="the plane y = 99 mm lies outside the volume, from -16 to 16 mm"):
        RunContent.of("toy", GRID, NAMES, content().result, None, None, (0, 99, 0))
    with pytest.raises(InputError, match=r"toy has no basis 'iodine', only photoelectric, compton, kedge_63.3"):
        chosen_bases(content(), "iodine")
    assert chosen_bases(content(), "compton") == [1]
    assert chosen_bases(content(), None) == [0, 1, 2]


@given(arrays(np.float32, (3, 2, 2, 3), elements=st.floats(-0.125, 0.125, width=32)))
def test_a_voxel_gets_the_material_whose_coefficients_are_nearest(volumes):
    found = nearest_materials(volumes, COEFFICIENTS)
    largest = COEFFICIENTS.max(axis=0)
    for place in np.ndindex(2, 2, 3):
        value = volumes[(slice(None), *place)] / largest
        away = [np.sum((value - centre / largest) ** 2) for centre in (np.zeros(3), *COEFFICIENTS)]
        assert away[found[place]] == pytest.approx(min(away))


def test_surfaces_of_the_result_lie_where_those_of_the_truth_do():
    (_, true, colours), (_, found, same) = surfaces(replace(content(), result=boxes().volumes), None)
    assert [m.name for m in true] == [m.name for m in found] == ["tissue", "bone", "contrast"]
    assert colours == same
    for known, body in zip(true, found, strict=True):
        assert (known.inner is None) == (body.inner is None)
        assert body.grid.shape == (18, 18, 18)
        assert body.fraction.max() > body.level
        where = np.argwhere(body.fraction > 0.5).mean(axis=0) * body.grid.spacing + body.grid.origin
        there = np.argwhere(known.fraction > 0.5).mean(axis=0) * known.grid.spacing + known.grid.origin
        assert where == pytest.approx(there, abs=0.5)


def test_a_material_that_the_result_lacks_has_no_surface():
    nothing = content().result.copy()
    nothing[2] = 0
    (_, true, _), (_, found, _) = surfaces(replace(content(), result=nothing), None)
    assert [m.name for m in true] == ["tissue", "bone", "contrast"]
    assert [m.name for m in found] == ["tissue", "bone"]


def test_a_single_wrong_voxel_has_no_surface():
    (body,) = (m for m in materials(boxes()) if m.name == "bone")
    result = boxes().volumes.copy()
    result[:, 4:12, 6:10, 3:6] = COEFFICIENTS[0][:, None, None, None]
    result[:, 8, 8, 8] = COEFFICIENTS[1]
    _, (_, found, _) = surfaces(replace(content(), result=result), None)
    assert body.name not in {m.name for m in found}


def test_levels_have_bodies_in_truth_and_result():
    (first, true, _), (second, found, colours) = surfaces(content(), {"kedge_63.3": 0.015, "compton": 0.01})
    assert (first, second) == ("true levels", "levels in the result")
    assert [m.name for m in true] == ["Compton above 0.01 1/mm", "K-edge 63.3 keV above 0.015 1/mm"]
    assert [m.name for m in found] == ["Compton above 0.01 1/mm"]
    assert colours == ["#56B4E9"]
    assert (true[0].inner is None, true[1].inner is None) == (False, True)


def test_a_body_reaches_as_far_as_its_voxels():
    (body,) = level_bodies(content().result, GRID, NAMES, {"photoelectric": 0.01})
    filled = np.argwhere(body.fraction > body.level)
    first = filled.min(axis=0) * body.grid.spacing + body.grid.origin
    assert first[::-1] == pytest.approx([-9.0, -3.0, -7.0])  # centres of voxels (4, 6, 3)


def test_usual_levels_part_the_object_from_its_surroundings():
    levels = usual_levels(content(names=("photoelectric", "compton")))
    assert list(levels) == ["photoelectric", "compton"]
    assert 0.002 < levels["photoelectric"] < 0.018
    assert 0 < levels["compton"] < 0.02
    [(title, found, _)] = surfaces(content(truth=False), None)
    assert (title, len(found)) == ("levels in the result", 3)


def test_a_few_voxels_that_overshoot_do_not_darken_a_result_without_truth():
    shown = content(truth=False)
    shown.result[1, 2, 2, 2:6] = 0.05
    assert shown.scale(1)[0] == pytest.approx(0.03, abs=1.1e-3)
    shown.result[1] = 0
    assert shown.scale(1) == (1.0, 3)


def test_levels_are_read_or_refused():
    assert parse_levels(()) is None
    assert parse_levels(("compton=0.01", "kedge_63.3=2e-3")) == {"compton": 0.01, "kedge_63.3": 0.002}
    for wrong in ("compton", "compton=", "compton=-1", "compton=nan", "compton=0"):
        with pytest.raises(InputError, match="a level is written BASIS=VALUE with a positive value in 1/mm"):
            parse_levels((wrong,))
    with pytest.raises(InputError, match="toy has no basis 'iodine'"):
        surfaces(content(), {"iodine": 1.0})


def test_ellipsoids_are_one_standard_deviation_from_the_centres():
    model = gaussians()
    found = ellipsoids(model, -100.0)
    assert (found.count, found.share) == (4, 1.0)  # one has no coefficient
    ball = found.mesh.n_points // 4
    for i, points in enumerate(found.mesh.points.reshape(4, ball, 3)):
        away = points - model.centres[i].numpy()
        sigma = model.log_scales[i].exp().numpy()
        if i == 2:
            sigma = sigma[[1, 0, 2]]  # turned by a quarter about z
        assert np.sum((away / sigma) ** 2, axis=1) == pytest.approx(np.ones(ball), abs=1e-4)
        assert np.ptp(away, axis=0) == pytest.approx(2 * sigma, rel=0.16)  # few corners
    normals = found.mesh.point_data["Normals"]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(4 * ball), abs=1e-5)
    outward = normals[:ball] * (found.mesh.points[:ball] - model.centres[0].numpy())
    assert outward.sum(axis=1).min() > 0


def test_ellipsoids_of_most_mass_beyond_the_plane_are_taken():
    model = gaussians()
    mass = masses(model)
    assert mass[0] == pytest.approx(8 * mass[1])
    beyond = ellipsoids(model, 0.0)
    assert beyond.count == 2
    one = ellipsoids(model, 0.0, most=1)
    assert one.count == 1
    assert one.share == pytest.approx(mass[2] / (mass[2] + mass[3]))
    assert one.mesh.center == pytest.approx((5.0, 6.0, 8.0), abs=1e-3)
    assert ellipsoids(model, 50.0).count == 0
    assert ellipsoids(model, 50.0).mesh.n_points == 0
