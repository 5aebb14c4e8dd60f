"""The YCB objects of DexYCB: numbers, names, masses and heights."""

from __future__ import annotations

_OBJECTS = {
    1: ("002_master_chef_can", 0.414, 0.069),
    2: ("003_cracker_box", 0.411, 0.105),
    3: ("004_sugar_box", 0.514, 0.087),
    4: ("005_tomato_soup_can", 0.349, 0.05),
    5: ("006_mustard_bottle", 0.603, 0.083),
    6: ("007_tuna_fish_can", 0.171, 0.016),
    7: ("008_pudding_box", 0.187, 0.022),
    8: ("009_gelatin_box", 0.097, 0.018),
    9: ("010_potted_meat_can", 0.37, 0.052),
    10: ("011_banana", 0.066, 0.052),
    11: ("019_pitcher_base", 0.178, 0.1462),
    12: ("021_bleach_cleanser", 1.131, 0.11),
    13: ("024_bowl", 0.147, 0.025),
    14: ("025_mug", 0.118, 0.039),
    15: ("035_power_drill", 0.895, 0.039),
    16: ("036_wood_block", 0.729, 0.1167),
    17: ("037_scissors", 0.082, 0.0092),
    18: ("040_large_marker", 0.0158, 0.007),
    19: ("051_large_clamp", 0.125, 0.008),
    20: ("052_extra_large_clamp", 0.202, 0.017),
    21: ("061_foam_brick", 0.028, 0.025),
}
"""Name, mass [kg] and height [m] by the number in DexYCB's ``ycb_ids`` and D-Grasp's labels. Masses are those
of full packages (Calli et al., "Benchmarking in Manipulation Research", 2015). The height is that of the
origin of D-Grasp's mesh above the table at rest."""

YCB_NAMES = {number: name for number, (name, _, _) in _OBJECTS.items()}
YCB_MASSES = {name: mass for name, mass, _ in _OBJECTS.values()}
YCB_REST_HEIGHTS = {name: height for name, _, height in _OBJECTS.values()}
