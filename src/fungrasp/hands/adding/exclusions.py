"""Pairs of links that may pass through each other."""

from __future__ import annotations

from itertools import combinations

import mujoco

from fungrasp.hands.adding.link_shapes import HandShapes
from fungrasp.hands.adding.model_file import ForeignModel
from fungrasp.hands.adding.structure import HandStructure
from fungrasp.hands.checking.finding import Finding, listed, note
from fungrasp.hands.checking.kinematic_tree import body_name
from fungrasp.hands.self_contacts import self_contacts, zero_and_random_poses

ALWAYS = 0.6
"""Share of the poses in which shapes that touch are said to touch always."""

OFTEN = 0.03
"""The palm and a link before a fingertip that touch in more poses than this may pass through each other:
limits of joints keep the true ones apart."""

TOUCH = 5e-4
"""Overlap of shapes that counts [m]."""


def exclude_neighbors(
    spec: mujoco.MjSpec,
    foreign: ForeignModel,
    structure: HandStructure,
    shapes: HandShapes,
    findings: list[Finding],
) -> None:
    """Let neighbors, links of one finger, and shapes that always touch pass through each other."""

    def name(body: int) -> str:
        return body_name(foreign.model, body)

    palm = name(structure.palm)
    pairs: set[tuple[str, str]] = set()
    for chain in structure.fingers.values():
        members = [name(b) for b in chain.bodies]
        pairs |= {_pair(*pair) for pair in combinations(members, 2)}
    for body in shapes.links:
        if body != structure.palm:
            parent = shapes.owner(int(foreign.model.body_parentid[body]))
            pairs.add(_pair(name(body), name(parent)))
    for chain in structure.fingers.values():
        # Joints in one place make the first shape of a finger a neighbor of the palm.
        for body in chain.bodies:
            pairs.add(_pair(palm, name(body)))
            if body == chain.links[0]:
                break
    always, inner = [], []
    last = {name(chain.bodies[-1]) for chain in structure.fingers.values()}
    model = spec.copy().compile()
    poses = zero_and_random_poses(model)
    for contact in self_contacts(model, poses[:1], TOUCH):
        always.append(_pair(contact.first, contact.second))
    for contact in self_contacts(model, poses[1:], TOUCH):
        pair = _pair(contact.first, contact.second)
        if contact.share > ALWAYS:
            always.append(pair)
        elif palm in pair and contact.share > OFTEN and not last & set(pair):
            inner.append(pair)
    for text, found in (
        ("touch always or at zero", always),
        ("touch where only their shapes, which are coarser than the links, can be the reason", inner),
    ):
        extra = sorted(set(found) - pairs)
        pairs |= set(extra)
        if extra:
            shown = [f"{first} and {second}" for first, second in extra]
            findings.append(note(f"these {text}, and may pass through each other: {listed(shown)}"))
    for first, second in sorted(pairs):
        spec.add_exclude(bodyname1=first, bodyname2=second)


def _pair(first: str, second: str) -> tuple[str, str]:
    return (first, second) if first < second else (second, first)
