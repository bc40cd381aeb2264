"""Tissues of the labels that segmentation programs write."""

_LEFT_RIGHT = ("left", "right")
_VERTEBRAE = (
    "S1",
    *(f"L{n}" for n in range(5, 0, -1)),
    *(f"T{n}" for n in range(12, 0, -1)),
    *(f"C{n}" for n in range(7, 0, -1)),
)
# TotalSegmentator, task `total` of version 2: names of the labels 1 to 117 (Wasserthal et al. 2023,
# doi:10.1148/ryai.230024, and the program's list of classes), and the material that each is taken as.
_TOTALSEGMENTATOR = (
    ("spleen", "spleen"),
    ("kidney_right", "kidney"),
    ("kidney_left", "kidney"),
    ("gallbladder", "water"),
    ("liver", "liver"),
    ("stomach", "soft tissue"),
    ("pancreas", "pancreas"),
    ("adrenal_gland_right", "soft tissue"),
    ("adrenal_gland_left", "soft tissue"),
    ("lung_upper_lobe_left", "lung"),
    ("lung_lower_lobe_left", "lung"),
    ("lung_upper_lobe_right", "lung"),
    ("lung_middle_lobe_right", "lung"),
    ("lung_lower_lobe_right", "lung"),
    ("esophagus", "soft tissue"),
    ("trachea", "air"),
    ("thyroid_gland", "thyroid"),
    ("small_bowel", "soft tissue"),
    ("duodenum", "soft tissue"),
    ("colon", "soft tissue"),
    ("urinary_bladder", "water"),
    ("prostate", "soft tissue"),
    ("kidney_cyst_left", "water"),
    ("kidney_cyst_right", "water"),
    ("sacrum", "spongiosa"),
    *((f"vertebrae_{name}", "spongiosa") for name in _VERTEBRAE),
    ("heart", "heart"),
    *(
        (name, "blood")
        for name in (
            "aorta",
            "pulmonary_vein",
            "brachiocephalic_trunk",
            "subclavian_artery_right",
            "subclavian_artery_left",
            "common_carotid_artery_right",
            "common_carotid_artery_left",
            "brachiocephalic_vein_left",
            "brachiocephalic_vein_right",
            "atrial_appendage_left",
            "superior_vena_cava",
            "inferior_vena_cava",
            "portal_vein_and_splenic_vein",
            "iliac_artery_left",
            "iliac_artery_right",
            "iliac_vena_left",
            "iliac_vena_right",
        )
    ),
    *(
        (f"{bone}_{side}", "spongiosa")
        for bone in ("humerus", "scapula", "clavicula", "femur", "hip")
        for side in _LEFT_RIGHT
    ),
    ("spinal_cord", "brain"),
    *((f"gluteus_{which}_{side}", "muscle") for which in ("maximus", "medius", "minimus") for side in _LEFT_RIGHT),
    *((f"{muscle}_{side}", "muscle") for muscle in ("autochthon", "iliopsoas") for side in _LEFT_RIGHT),
    ("brain", "brain"),
    ("skull", "cranium"),
    *((f"rib_{side}_{n}", "spongiosa") for side in _LEFT_RIGHT for n in range(1, 13)),
    ("sternum", "spongiosa"),
    ("costal_cartilages", "cartilage"),
)
NAMES = {"totalsegmentator": dict(enumerate((name for name, _ in _TOTALSEGMENTATOR), start=1))}
TISSUES = {"totalsegmentator": dict(enumerate((tissue for _, tissue in _TOTALSEGMENTATOR), start=1))}
