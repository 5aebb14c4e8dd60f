"""The YCB objects of DexYCB: numbers, names, masses."""

from __future__ import annotations

from collections.abc import Mapping

YCB_NAMES: Mapping[int, str] = {
    1: "002_master_chef_can",
    2: "003_cracker_box",
    3: "004_sugar_box",
    4: "005_tomato_soup_can",
    5: "006_mustard_bottle",
    6: "007_tuna_fish_can",
    7: "008_pudding_box",
    8: "009_gelatin_box",
    9: "010_potted_meat_can",
    10: "011_banana",
    11: "019_pitcher_base",
    12: "021_bleach_cleanser",
    13: "024_bowl",
    14: "025_mug",
    15: "035_power_drill",
    16: "036_wood_block",
    17: "037_scissors",
    18: "040_large_marker",
    19: "051_large_clamp",
    20: "052_extra_large_clamp",
    21: "061_foam_brick",
}
"""Name by the number that DexYCB's ``ycb_ids`` and D-Grasp's labels use."""

YCB_MASSES: Mapping[str, float] = {
    "002_master_chef_can": 0.414,
    "003_cracker_box": 0.411,
    "004_sugar_box": 0.514,
    "005_tomato_soup_can": 0.349,
    "006_mustard_bottle": 0.603,
    "007_tuna_fish_can": 0.171,
    "008_pudding_box": 0.187,
    "009_gelatin_box": 0.097,
    "010_potted_meat_can": 0.370,
    "011_banana": 0.066,
    "019_pitcher_base": 0.178,
    "021_bleach_cleanser": 1.131,
    "024_bowl": 0.147,
    "025_mug": 0.118,
    "035_power_drill": 0.895,
    "036_wood_block": 0.729,
    "037_scissors": 0.082,
    "040_large_marker": 0.0158,
    "051_large_clamp": 0.125,
    "052_extra_large_clamp": 0.202,
    "061_foam_brick": 0.028,
}
"""Mass by name [kg], full packages: Calli et al., "Benchmarking in Manipulation Research", 2015."""

YCB_REST_HEIGHTS: Mapping[str, float] = {
    "002_master_chef_can": 0.069,
    "003_cracker_box": 0.105,
    "004_sugar_box": 0.087,
    "005_tomato_soup_can": 0.050,
    "006_mustard_bottle": 0.083,
    "007_tuna_fish_can": 0.016,
    "008_pudding_box": 0.022,
    "009_gelatin_box": 0.018,
    "010_potted_meat_can": 0.052,
    "011_banana": 0.052,
    "019_pitcher_base": 0.1462,
    "021_bleach_cleanser": 0.110,
    "024_bowl": 0.025,
    "025_mug": 0.039,
    "035_power_drill": 0.039,
    "036_wood_block": 0.1167,
    "037_scissors": 0.0092,
    "040_large_marker": 0.007,
    "051_large_clamp": 0.008,
    "052_extra_large_clamp": 0.017,
    "061_foam_brick": 0.025,
}
"""Height of the origin of D-Grasp's mesh above the table while the object rests on it [m], by name."""
