"""A torso of solids: skin, fat, muscle, skeleton, lungs, heart, vessels and upper abdomen.

Sizes are nominal, near those of the reference adult (ICRP Publication 89); z = 0 lies at the eighth thoracic vertebra.
"""

from math import cos, radians, sin, tan

from phantomgen.scene.bodies.additions import Places, added
from phantomgen.scene.bodies.solids import (
    Object,
    ball,
    beyond,
    block,
    both,
    chain,
    column,
    ellipsoid,
    mirrored,
    rod,
)
from phantomgen.scene.bodies.tissues import Materials, Uptake, lung, own
from phantomgen.scene.schema.bodies import TorsoModel
from spectra.errors import InputError

# Half axes of the muscles of the trunk, and its height [mm].
_TRUNK, _HEIGHT = (158.0, 104.0), 400.0
_SKIN = 2.0
_RIBS, _TRUE_RIBS, _RIB_STEP, _RIB_TILT = 10, 7, 22.0, 24.0
# Points of a rib that are bone; the others are cartilage.
_BONY = 8
_SPINE = 68.0  # y of the middle of the vertebrae
_FEMALE = 0.92


def torso(model: TorsoModel) -> tuple[list[Object], Materials, float]:
    """Create the objects of a torso.

    Parameters
    ----------
    model : its keys

    Returns
    -------
    objects, lowest priority first; materials that they need and that have no name of their own; and the scale that
    makes the reference adult this person

    Raises
    ------
    InputError
        Where an addition lies in no part of the body.
    """
    if model.lesion is not None and model.lesion.organ == "breast" and model.sex == "male":
        raise InputError("a lesion of the breast needs 'sex: female'")
    scale = model.size * (_FEMALE if model.sex == "female" else 1.0)
    blood = Uptake(model.contrast)
    objects = [
        *_outside(model, scale),
        *_chest(model),
        *_abdomen(model, blood),
        *_heart(model, blood),
        *_vessels(blood),
        *_spine(),
        *_rib_cage(),
    ]
    if model.arms == "down":
        objects += _arms(model.fat / scale)
    objects += [*added(model, PLACES, scale)]
    return objects, {**lung(model.inflation), **own(objects), **blood.materials}, scale


# Usual places of what is added; of vessels with their direction and inner radius.
PLACES = Places(
    organs={
        "lung": ((-78.0, 10.0, 40.0), "muscle"),
        "liver": ((-70.0, 5.0, -105.0), "soft tissue"),
        "kidney": ((58.0, 48.0, -165.0), "water"),
        "spleen": ((92.0, 42.0, -110.0), "water"),
        "breast": ((75.0, -118.0, 20.0), "muscle"),
        "bone": ((0.0, _SPINE, -14.0), "soft tissue"),
    },
    vessels={
        "coronary": ((44.0, -46.0, 12.0), (0.35, -0.25, -0.9), 1.8),
        "aorta": ((20.0, 44.0, -60.0), (0.0, 0.0, 1.0), 11.0),
    },
)


def _outside(model: TorsoModel, scale: float) -> list[Object]:
    """Skin, fat and muscles."""
    fat, (wide, deep) = model.fat / scale, _TRUNK
    shoulders = (0.0, 6.0, 0.5 * _HEIGHT - 62)
    found = []
    for material, more in (("skin", fat + _SKIN), ("adipose", fat), ("muscle", 0.0)):
        found += [
            column(material, (0, 0, -20), (wide + more, deep + more), _HEIGHT - 40),
            ellipsoid(material, shoulders, (192 + more, 84 + more, 70 + more)),
            column(material, (0, 16, 0.5 * _HEIGHT + 10), (56 + 0.5 * more, 58 + 0.5 * more), 60),
        ]
    if model.sex == "female":
        for material, radius in (("skin", 58.0 + 0.5 * fat), ("breast", 56.0 + 0.5 * fat)):
            found += both(ellipsoid(material, (76, -92, 22), (radius, 0.9 * radius, radius)))
        # the wall of the chest behind the breasts
        found.append(column("muscle", (0, 0, 20), _TRUNK, 160))
    # fat around the organs of the abdomen
    found.append(column("adipose", (0, -8, -130), (132, 78), 140))
    return found


def _chest(model: TorsoModel) -> list[Object]:
    """Lungs, the space between them, and the airways; the diaphragm lies lower where the lungs are inflated."""
    low = -52 - 22 * model.inflation
    floor = [beyond((0, 0, -1), -low)]
    found = []
    for side, wide in ((-1, 58.0), (1, 53.0)):
        found.append(
            {**ellipsoid("inflated lung", (76 * side, 4, 20), (wide, 84, 138), (4, -4 * side, 0)), "clip": floor}
        )
    found.append(ellipsoid("adipose", (2, 2, 40), (32, 62, 120)))
    if model.respiration is not None:
        moving = {"signal": model.respiration, "scale": [1.05, 1.1, 1.12], "shift": [0, 0, -6]}
        found[0]["motion"] = found[1]["motion"] = moving
    # bronchi and branches of the pulmonary vessels, which reach from the middle into both lungs
    for item in (
        rod("air", (6, 30, 92), (34, 26, 66), 7),
        rod("air", (34, 26, 66), (62, 22, 40), 4),
        rod("air", (34, 26, 66), (66, 16, 88), 3.2),
    ):
        found += both(item)
    return [*found, column("cartilage", (0, 30, 146), 11, 112), column("air", (0, 30, 146), 9, 112)]


def _abdomen(model: TorsoModel, blood: Uptake) -> list[Object]:
    """Liver, stomach, spleen, kidneys, pancreas and bowel; domes of the diaphragm move with the breath."""
    lower = -20 * model.inflation
    organs = [
        ellipsoid(blood["liver"], (-62, -2, -78 + lower), (84, 78, 62), (0, 12, 0)),
        ellipsoid(blood["spleen"], (92, 42, -86 + lower), (26, 38, 46), (10, 0, 0)),
        ellipsoid("muscle", (58, -22, -92 + lower), (46, 40, 46), (0, 20, 0)),
        ellipsoid("water", (58, -22, -92 + lower), (41, 35, 41), (0, 20, 0)),
        {
            **ellipsoid("air", (58, -22, -92 + lower), (41, 35, 41), (0, 20, 0)),
            "clip": [beyond((0, 1, 0), -38)],  # the gas lies in front, as the person lies on the back
        },
        ellipsoid("adipose", (-54, -44, -122 + lower), (14, 16, 24)),
        ellipsoid("water", (-54, -44, -122 + lower), (13, 15, 23)),  # gall bladder
    ]
    if model.respiration is not None:
        organs = [{**item, "motion": {"signal": model.respiration, "shift": [0, 2, -14]}} for item in organs]
    kidney = ellipsoid(blood["kidney"], (58, 48, -165), (24, 20, 46), (0, 10, 0))
    pelvis = ellipsoid("adipose", (48, 44, -165), (12, 9, 20), (0, 10, 0))
    found = [*organs, *both(kidney), *both(pelvis)]
    found.append(ellipsoid("pancreas", (14, -6, -142), (48, 11, 14), (0, -14, 0)))
    for x, y, z, gas in ((-92, -20, -172, 12), (94, -16, -178, 11), (30, -50, -180, 9), (-26, -54, -186, 10)):
        found += [ball("muscle", (x, y, z), 19), ball("soft tissue", (x, y, z), 16), ball("air", (x, y - 5, z), gas)]
    return found


def _heart(model: TorsoModel, blood: Uptake) -> list[Object]:
    """Both ventricles and atria, at rest or with a beat."""
    tilt = (28, 24, -38)
    beat = {} if model.heartbeat is None else {"motion": {"signal": model.heartbeat, "scale": 0.9}}
    squeeze = {} if model.heartbeat is None else {"motion": {"signal": model.heartbeat, "scale": 0.72}}
    parts = [
        {**ellipsoid("adipose", (16, -22, 2), (60, 50, 56), tilt)},
        {**ellipsoid(blood["heart"], (18, -22, 0), (55, 44, 50), tilt), **beat},
        {**ellipsoid(blood["arteries"], (32, -18, -4), (26, 20, 34), tilt), **squeeze},
        {**ellipsoid(blood["veins"], (-4, -40, 0), (25, 14, 30), tilt), **squeeze},
        {**ellipsoid(blood["veins"], (-32, -14, 14), (20, 24, 26)), **squeeze},
        {**ellipsoid(blood["arteries"], (4, 20, 26), (28, 17, 21)), **squeeze},
    ]
    if model.respiration is None:
        return parts
    return [{"type": "group", "objects": parts, "motion": {"signal": model.respiration, "shift": [0, 0, -6]}}]


def _vessels(blood: Uptake) -> list[Object]:
    """Aorta with its arch, hollow veins, pulmonary and coronary arteries; walls of muscle."""
    arteries, veins = blood["arteries"], blood["veins"]
    turns = [radians(180 - 22.5 * k) for k in range(9)]  # the arch, from front right to back left
    arch = [(9 + 9 * cos(t), 8 + 32 * cos(t), 92 + 33 * sin(t)) for t in turns]
    found = []
    for material, more in (("muscle", 1.8), (arteries, 0.0)):
        found += [
            rod(material, (2, -24, 40), (0, -24, 92), 14 + more),
            *chain(material, arch, 12.5 + more),
            rod(material, (18, 40, 92), (20, 44, -60), 11 + more),
            rod(material, (20, 44, -60), (10, 42, -190), 9 + more),
        ]
    for material, more in (("muscle", 1.0), (veins, 0.0)):
        found += [
            rod(material, (-30, -8, 34), (-26, -4, 150), 9 + more),
            rod(material, (-24, 30, -190), (-24, 12, 0), 12 + more),
            rod(material, (14, -44, 34), (18, -8, 72), 12 + more),
            rod(material, (18, -8, 72), (52, 6, 66), 9 + more),
            rod(material, (18, -8, 72), (-48, 10, 62), 9 + more),
        ]
    for item in (
        rod(veins, (52, 6, 66), (78, 4, 96), 5),
        rod(veins, (52, 6, 66), (84, 18, 36), 5.5),
        rod(veins, (84, 18, 36), (96, 40, 4), 3.2),
        rod(veins, (84, 18, 36), (104, -14, 20), 2.6),
        rod(veins, (78, 4, 96), (88, 20, 124), 2.6),
        rod(veins, (78, 4, 96), (96, -24, 104), 2.2),
    ):
        found += both(item)
    for x, y in ((-22, -14), (-4, 6), (18, 16)):  # branches to arms and head
        found += [rod("muscle", (x, y, 118), (2.2 * x, y, 200), 5), rod(arteries, (x, y, 118), (2.2 * x, y, 200), 4)]
    coronary = [((20, -44, 46), (36, -40, 34)), ((36, -40, 34), (50, -50, -10)), ((36, -40, 34), (64, -20, 2))]
    coronary += [((-12, -42, 44), (-34, -44, 12))]
    for start, end in coronary:
        found += [rod("muscle", start, end, 2.4), rod(arteries, start, end, 1.8)]
    return found


def _spine() -> list[Object]:
    """Vertebrae with arches and processes, discs, and the cord; the spine bends forward below the neck."""
    ends = [(0.0, _spine_at(z), z) for z in (-198.0, 50.0, 152.0)]
    found = chain("cartilage", ends, 14)
    for k in range(-7, 6):
        z, grown = 26.0 * k - 1, 1 - 0.012 * k
        y = _spine_at(z)
        found += [
            column("cortical bone", (0, y, z), (19 * grown, 15.5 * grown), 20),
            column("spongiosa", (0, y, z), (17.2 * grown, 13.7 * grown), 17),
            {"type": "tube", "material": "cortical bone", "center": [0, round(y + 23, 4), z], "radius": 13.5,
             "inner_radius": 9.5, "length": 12},
            ellipsoid("cortical bone", (0, y + 36, z - 8), (4, 10, 8), (-30, 0, 0)),
            *both(ellipsoid("cortical bone", (26, y + 22, z), (16, 5.5, 5.5), (0, 0, 12))),
        ]  # fmt: skip
    canal = [(x, y + 23, z) for x, y, z in ends]
    return [*found, *chain("water", canal, 8.5), *chain("brain", canal, 5)]


def _spine_at(z: float) -> float:
    """Place of the middle of the vertebrae along y [mm]."""
    return _SPINE - 0.12 * max(0.0, z - 50)


def _rib(k: int) -> list[tuple[float, float, float]]:
    """Points along the left rib `k` from the spine to the front, where it is lower."""
    part = k / (_RIBS - 1)
    width = 72 + 70 * sin(radians(90 * min(1.0, 1.25 * part + 0.12)))
    depth, points = 0.62 * width, []
    for turn in range(10, 171, 16):
        x, y = width * sin(radians(turn)), depth * cos(radians(turn))
        points.append((x, y + 2, 118 - _RIB_STEP * k + y * tan(radians(_RIB_TILT))))
    return points


def _rib_cage() -> list[Object]:
    """Ribs that fall towards the front, cartilages, breast bone, collar bones and shoulder blades."""
    found = []
    for k in range(_RIBS):
        curve = _rib(k)
        bony = curve[:_BONY] if k < _TRUE_RIBS else curve[: _BONY + 1]
        side = chain("cartilage", curve[_BONY - 1 :], 4.5) if k < _TRUE_RIBS else []
        side += [*chain("cortical bone", bony, 5.4), *chain("spongiosa", bony, 3.6)]
        found += [item for one in side for item in both(one)]
    found += [
        block("cortical bone", (0, -84, 32), (34, 11, 118), (-8, 0, 0)),
        block("spongiosa", (0, -84, 32), (30, 8, 114), (-8, 0, 0)),
        block("cortical bone", (0, -72, 104), (56, 12, 40), (-16, 0, 0)),
        block("spongiosa", (0, -72, 104), (52, 9, 36), (-16, 0, 0)),
        *both(rod("cortical bone", (28, -62, 122), (148, -14, 148), 6.5)),
        *both(rod("spongiosa", (28, -62, 122), (148, -14, 148), 4.5)),
        *both(ellipsoid("cortical bone", (92, 80, 72), (38, 4, 66), (-6, 12, -36))),
        *both(ellipsoid("cortical bone", (152, 28, 138), (22, 20, 18))),
        *both(ellipsoid("spongiosa", (152, 28, 138), (20, 18, 16))),
    ]
    return found


def _arms(fat: float) -> list[Object]:
    """Upper arms beside the chest."""
    lean = 0.6 * fat
    x = 214 + lean + 0.5 * fat
    found = []
    for material, radius in (
        ("skin", 44 + lean + _SKIN),
        ("adipose", 44 + lean),
        ("muscle", 44.0),
        ("cortical bone", 12.5),
        ("yellow marrow", 7.5),
    ):
        item = rod(material, (182, 20, 128), (x, 20, -190), radius)
        found += [item, mirrored(item)]
    return [*found, *both(ball("cortical bone", (178, 20, 134), 24)), *both(ball("spongiosa", (178, 20, 134), 21.5))]
