"""A head of solids: skin, fat, skull with its sinuses, brain, eyes, jaws with teeth, neck and vessels.

Sizes are nominal, near those of an adult; z = 0 lies at the height of the eyes.
"""

from math import cos, radians, sin

from phantomgen.scene.bodies.additions import Places, added
from phantomgen.scene.bodies.solids import Object, ball, beyond, block, both, chain, column, ellipsoid, rod
from phantomgen.scene.bodies.tissues import Materials, Uptake, own
from phantomgen.scene.schema.bodies import HeadModel

_SKIN = 1.5
_FEMALE = 0.95
# Middle and half axes of the inside of the skull [mm].
_BRAIN, _INSIDE = (0.0, 6.0, 36.0), (67.0, 84.0, 66.0)
_CROWNS = {"gold": "gold alloy", "titanium": "titanium", "amalgam": "amalgam"}
_CROWNED = (3, 4, 9)  # teeth from the right, of each jaw

PLACES = Places(
    organs={
        "brain": ((26.0, -18.0, 44.0), "blood"),
        "cerebellum": ((18.0, 40.0, -4.0), "blood"),
        "bone": ((0.0, -74.0, 62.0), "soft tissue"),
    },
    vessels={"carotid": ((27.0, 4.0, -96.0), (0.0, 0.0, 1.0), 3.2)},
)


def head(model: HeadModel) -> tuple[list[Object], Materials, float]:
    """Create the objects of a head.

    Parameters
    ----------
    model : its keys

    Returns
    -------
    objects, lowest priority first; materials that they need and that have no name of their own; and the scale that
    makes the adult this person
    """
    scale = model.size * (_FEMALE if model.sex == "female" else 1.0)
    blood = Uptake(model.contrast)
    objects = [
        *_outside(model.fat / scale),
        *_skull(),
        *_face(),
        *_brain(blood),
        *_jaws(model),
        *_neck(blood),
        *added(model, PLACES, scale),
    ]
    return objects, {**own(objects), **blood.materials}, scale


def _outside(fat: float) -> list[Object]:
    """Skin, fat and muscles."""
    found = []
    for material, more in (("skin", fat + _SKIN), ("adipose", fat), ("muscle", 0.0)):
        found += [
            ellipsoid(material, _BRAIN, [radius + 8 + 0.6 * more for radius in _INSIDE]),
            ellipsoid(material, (0, -38, -42), (60 + more, 60 + more, 76 + more)),
            column(material, (0, 14, -105), (56 + more, 58 + more), 170),
            ellipsoid(material, (0, -98, -32), (12 + 0.3 * more, 16 + 0.3 * more, 22 + 0.3 * more)),
            *both(ellipsoid(material, (76, 16, -14), (7 + 0.2 * more, 15, 29), (0, 0, 24))),
        ]
    return found


def _skull() -> list[Object]:
    """Cranium of two tables with spongiosa between, base of the skull with the petrous bones, and sinuses."""
    outer, middle = ([radius + more for radius in _INSIDE] for more in (6.5, 4.5))
    inner = [radius + 2.0 for radius in _INSIDE]
    return [
        ellipsoid("cranium", _BRAIN, outer),
        ellipsoid("spongiosa", _BRAIN, middle),
        ellipsoid("cranium", _BRAIN, inner),
        ellipsoid("water", _BRAIN, _INSIDE),  # cerebrospinal fluid
    ]


def _face() -> list[Object]:
    """Facial bones, eyes, and the spaces of air."""
    found = [
        block("cranium", (0, -14, -30), (92, 66, 12), (-14, 0, 0)),
        *both(ellipsoid("cranium", (42, 16, -24), (24, 12, 13), (0, 0, 40))),
        *both(ellipsoid("cranium", (51, 30, -36), (12, 15, 20))),
        ellipsoid("cranium", (0, -64, -48), (36, 24, 30)),
        *both(ellipsoid("cranium", (46, -58, -32), (16, 14, 11), (0, 0, -30))),
        *both(ellipsoid("cranium", (33, -62, -6), (20, 24, 19))),
        *both(ellipsoid("adipose", (33, -63, -6), (17.5, 25, 16.5))),
        *both(ball("water", (33, -76, -6), 12)),
        *both(ellipsoid("eye lens", (33, -85.5, -6), (4.6, 2.0, 4.6))),
        *both(rod("muscle", (24, -46, -7), (32, -64, -6), 2.2)),
        *both(ellipsoid("air", (30, -66, -42), (12, 15, 16))),
        *both(ellipsoid("air", (10, -86, 26), (9, 5, 12))),
        *both(ellipsoid("air", (9, -64, -6), (5, 18, 11))),
        *both(ellipsoid("air", (8, -30, -18), (7, 11, 9))),
        *both(ellipsoid("air", (7, -70, -40), (4.5, 30, 18))),
        ellipsoid("air", (0, -24, -64), (14, 12, 24)),
        *both(rod("air", (50, 14, -24), (82, 14, -20), 3.5)),
    ]
    cells = [(52, 28, -28), (55, 34, -36), (49, 37, -34), (53, 26, -42), (48, 32, -45), (57, 28, -34)]
    for place in cells:  # mastoid cells
        found += both(ball("air", place, 3.2))
    return found


def _brain(blood: Uptake) -> list[Object]:
    """Brain with ventricles, falx, and vessels."""
    arteries, veins = blood["arteries"], blood["veins"]
    _, y, z = _BRAIN
    above = [beyond((0, 0, -1), 12)]
    found = [
        {**ellipsoid("brain", _BRAIN, [radius - 2.5 for radius in _INSIDE]), "clip": above},
        ellipsoid("brain", (0, 36, -2), (42, 25, 18)),
        rod("brain", (0, 12, 10), (0, 22, -44), 13),
        {**ellipsoid("soft tissue", (0, y, z + 8), (0.8, 78, 52)), "clip": [beyond((0, 0, -1), -24)]},
        *both(ellipsoid("water", (12, -6, 46), (7, 30, 11), (-12, 0, -8))),
        *both(ellipsoid("water", (24, 28, 36), (6, 16, 8), (20, 0, 24))),
        ellipsoid("water", (0, 0, 28), (2.5, 15, 11)),
        ellipsoid("water", (0, 26, -8), (6, 5, 8)),
    ]
    along = [radians(10 * k) for k in range(3, 19)]
    sinus = [(0.0, y - 81 * cos(t), z + 64 * sin(t)) for t in along]  # from the forehead to the back
    circle = [(11 * sin(t), -16 - 13 * cos(t), -2.0) for t in (radians(30 * k) for k in range(13))]
    found += [
        *chain(veins, sinus, 3.0),
        *chain(arteries, circle, 1.6),
        rod(arteries, (0, -3, -2), (0, 8, -32), 1.8),
        *both(rod(arteries, (11, -16, -2), (13, -20, -34), 2.2)),
        *both(rod(arteries, (11, -18, -2), (40, -24, 6), 1.5)),
        *both(rod(arteries, (40, -24, 6), (52, -4, 30), 1.1)),
        *both(rod(arteries, (5, -28, -2), (2, -60, 30), 1.1)),
        *both(rod(arteries, (8, -6, -2), (26, 34, 6), 1.1)),
    ]
    return found


def _jaws(model: HeadModel) -> list[Object]:
    """Lower jaw, which may be open, hard palate, tongue, and two rows of teeth."""
    low = -model.mouth
    arch = [beyond((0, 1, 0), -26)]
    found = [
        block("cranium", (0, -58, -72), (44, 40, 6)),
        ellipsoid("muscle", (0, -56, -92 + 0.5 * low), (22, 32, 17)),
        {**_bow("cortical bone", (0, -36, -106 + low), (47, 56), 12, 26), "clip": arch},
        {**_bow("spongiosa", (0, -36, -106 + low), (45.5, 54.5), 9, 22), "clip": arch},
        *both(block("cortical bone", (44, -12, -74 + 0.6 * low), (7, 26, 62), (18, 0, 0))),
        *both(block("spongiosa", (44, -12, -74 + 0.6 * low), (4, 22, 58), (18, 0, 0))),
    ]
    for upper in (True, False):
        z = -82.0 if upper else -90.0 + low
        for number in range(14):
            turn = radians(-80 + 160 * number / 13)
            place = (27.0 * sin(turn), -50.0 - 36.0 * cos(turn), z)
            width = 4.6 if number in (0, 1, 2, 11, 12, 13) else 3.4
            crowned = model.crowns != "none" and number in _CROWNED
            found.append(ellipsoid("enamel", place, (width, width, 9)))
            if crowned:
                found.append(
                    ellipsoid(_CROWNS[model.crowns], (*place[:2], z + (-5 if upper else 5)), (width, width, 4.5))
                )
    if model.mouth > 4:
        found.append(ellipsoid("air", (0, -74, -86 + 0.5 * low), (20, 22, 0.42 * model.mouth)))
    return found


def _bow(
    material: str, center: tuple[float, float, float], radii: tuple[float, float], wall: float, height: float
) -> Object:
    """A wall along an ellipse."""
    whole = column("", center, radii, height)
    hole = column("", center, [radius - wall for radius in radii], height + 1)
    del whole["material"], hole["material"]
    return {"type": "difference", "material": material, "base": whole, "cut": [hole]}


def _neck(blood: Uptake) -> list[Object]:
    """Vertebrae with discs and cord, airway, thyroid, and vessels."""
    found = [column("cartilage", (0, 22, -116), (11, 9), 140)]
    for k in range(7):
        z = -56.0 - 19.0 * k
        found += [
            column("cortical bone", (0, 22, z), (12.5, 10), 15),
            column("spongiosa", (0, 22, z), (11, 8.5), 12.5),
            {"type": "tube", "material": "cortical bone", "center": [0, 40, z], "radius": 14.5, "inner_radius": 10.5,
             "length": 9},
            ellipsoid("cortical bone", (0, 58, z - 4), (3.5, 10, 5), (-20, 0, 0)),
        ]  # fmt: skip
    found += [
        column("water", (0, 40, -116), 9.5, 148),
        column("brain", (0, 40, -116), (6.5, 5), 148),
        column("air", (0, -16, -92), (10, 6), 40),
        column("cartilage", (0, -20, -148), 11, 84),
        column("air", (0, -20, -148), 9, 84),
        *both(ellipsoid("thyroid", (16, -22, -162), (8, 9, 20))),
        *both(column("muscle", (27, 4, -110), 4.2, 160)),
        *both(column(blood["arteries"], (27, 4, -110), 3.2, 160)),
        *both(column("muscle", (37, 8, -114), 6.8, 150)),
        *both(column(blood["veins"], (37, 8, -114), 6.0, 150)),
        *both(column(blood["arteries"], (17, 26, -110), 1.8, 150)),
    ]
    return found
