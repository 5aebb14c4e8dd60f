"""``python -m benchmarks``: the benchmarks, with a line each."""

from __future__ import annotations

BENCHMARKS = {
    "speed": "retargeting, planning, training, a control step, the start of the program: how fast",
    "engines": "recorded grasps in another physics engine",
    "gpu": "worlds from one to thousands on each device: steps, rollouts, memory, shares",
    "peers": "retargeting beside other packages",
    "grasp_set": "makes human grasps of many objects, in parts to train, to validate and to test",
    "perception": "perceived hands and objects against the truth: rendered, varied and recorded captures",
    "wire": "deployments on twins over emulated wires, on the clock of the wall",
    "fault_series": "faults of all kinds in every phase of deployments on twins and over emulated wires",
    "hands": "hands of other makers: what hands add makes of their descriptions, how well they grasp",
    "identification": "fitted joint dynamics of twins against their truth",
    "paper": "the paper's tables of simulation",
    "cold_start": "a newcomer's first commands, from nothing",
    "builtin_objects": "writes the meshes of the built-in objects",
    "documents.tables": "the tables of README and docs, from lab/results",
}
"""Summary of each benchmark, by name."""

if __name__ == "__main__":
    print("usage: python -m benchmarks.NAME [OPTIONS]\n")
    for name, summary in BENCHMARKS.items():
        print(f"  {name:<17} {summary}")
