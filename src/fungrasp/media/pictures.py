"""Contact sheets, captions, pictures from four sides, pictures of grasps."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from fungrasp.core.errors import FungraspError
from fungrasp.core.files import atomic_path, check_suffix
from fungrasp.geometry.poses import transform_points
from fungrasp.grasps import HumanGraspSet, RobotGraspSet
from fungrasp.grasps.as_shown import PlaceMarks, place_marks
from fungrasp.hands import Hand
from fungrasp.hands.arm import mounting_pose
from fungrasp.media.camera import Camera
from fungrasp.media.grasp_scenes import frame_geoms, grasp_scene, look_at_grasp, view_angles
from fungrasp.media.render import Renderer, render
from fungrasp.media.visual_meshes import dressed_spec
from fungrasp.objects import ObjectModel

INK = (38, 42, 48)
PAPER = (250, 250, 248)


def grid(
    images: Sequence[np.ndarray],
    labels: Sequence[str] = (),
    columns: int = 4,
    *,
    gap: int = 10,
    size: int = 15,
) -> np.ndarray:
    """Arrange pictures in rows, with a caption under each.

    Args:
        images: sRGB, each of shape [H, W, 3] uint8, all of one size.
        labels: one per image, or none; long labels are shortened.
        gap: space between pictures [pixels].
        size: font size [pixels].

    Returns:
        sRGB, shape [H', W', 3] uint8.

    Raises:
        FungraspError: no images, images of different shapes, or a wrong number of labels.
    """
    if not images or columns < 1:
        raise FungraspError("a contact sheet needs at least one picture and one column")
    shape = images[0].shape
    if any(image.shape != shape for image in images):
        raise FungraspError(f"the pictures of a contact sheet must all have the shape of the first, {shape}")
    if labels and len(labels) != len(images):
        raise FungraspError(f"{len(labels)} labels were given for {len(images)} pictures")
    height, width = shape[:2]
    columns = min(columns, len(images))
    rows = -(-len(images) // columns)
    text = round(1.9 * size) if labels else 0
    sheet = Image.new("RGB", (gap + columns * (width + gap), gap + rows * (height + text + gap)), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(size)
    for i, image in enumerate(images):
        x, y = gap + i % columns * (width + gap), gap + i // columns * (height + text + gap)
        sheet.paste(Image.fromarray(image), (x, y))
        if labels:
            label = _shortened(labels[i], font, width)
            draw.text((x + width / 2, y + height + text / 2), label, fill=INK, font=font, anchor="mm")
    return np.asarray(sheet)


def captioned(image: np.ndarray, left: str, right: str = "") -> np.ndarray:
    """Add a caption bar at the lower edge of a picture.

    Args:
        image: sRGB, shape [H, W, 3] uint8.
        left: text at the left end of the bar.
        right: text at the right end.

    Returns:
        a new picture of the same shape.
    """
    height, width = image.shape[:2]
    size = max(10, round(height / 26))
    bar = round(2.1 * size)
    picture = Image.fromarray(image)
    shade = Image.new("RGB", (width, bar), (24, 27, 32))
    below = picture.crop((0, height - bar, width, height))
    picture.paste(Image.blend(below, shade, 0.72), (0, height - bar))
    draw, font = ImageDraw.Draw(picture), ImageFont.load_default(size)
    middle = height - bar / 2
    taken = draw.textlength(right, font=font) + 2 * size
    room = width - taken - 1.5 * size
    draw.text((size, middle), _shortened(left, font, room), fill=(248, 248, 246), font=font, anchor="lm")
    draw.text((width - size, middle), right, fill=(205, 209, 214), font=font, anchor="rm")
    return np.asarray(picture)


def four_views(model: mujoco.MjModel, azimuth: float = -60.0) -> list[np.ndarray]:
    """Render a model's reference state from four sides, alternately from low and high, for ``grid``: sRGB,
    shape [360, 480, 3] uint8 each.

    Args:
        azimuth: azimuth of the first view [degrees].
    """
    renderer, size = Renderer(model), {"width": 480, "height": 360}
    cameras = [
        frame_geoms(model, model.qpos0, azimuth + 90.0 * i, 22.0 + 18.0 * (i % 2), **size) for i in range(4)
    ]
    return [next(renderer.stream(model.qpos0, camera)) for camera in cameras]


PART_COLORS = {
    "blue": (0.36, 0.55, 0.72),
    "orange": (0.93, 0.55, 0.22),
    "green": (0.45, 0.66, 0.38),
    "red": (0.75, 0.35, 0.42),
    "violet": (0.58, 0.50, 0.70),
}
"""Colors of an object's parts, sRGB, in the order of the parts."""


PICTURES = (".png", ".jpg", ".jpeg")
"""Suffixes of picture files."""


def draw_object(path: Path, obj: ObjectModel, by_piece: bool = False) -> None:
    """Draw an object at rest on the table from four sides, with a color for each part or convex piece.

    Raises:
        FungraspError: the suffix is wrong, or the file can't be written.
    """
    if by_piece:
        shapes = [(piece.vertices, piece.faces) for piece in obj.pieces]
    else:
        masks = list(obj.parts.values()) or [np.ones(len(obj.faces), dtype=bool)]
        shapes = [(obj.vertices, obj.faces[mask]) for mask in masks]
    spec = mujoco.MjSpec()
    pose = obj.rest_pose()
    body = spec.worldbody.add_body(pos=pose[:3], quat=pose[3:])
    colors, names = list(PART_COLORS.values()), list(PART_COLORS)
    for i, (vertices, faces) in enumerate(shapes):
        used, renumbered = np.unique(faces, return_inverse=True)
        mesh = spec.add_mesh(name=f"shape_{i}", inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL)
        mesh.uservert = np.ascontiguousarray(vertices[used]).ravel()
        mesh.userface = renumbered.astype(np.int32).ravel()
        rgba = [*colors[i % len(colors)], 1.0]
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=mesh.name, rgba=rgba)
    parts = () if by_piece else obj.parts
    legend = ", ".join(f"{part} {names[i % len(names)]}" for i, part in enumerate(parts))
    size = " x ".join(f"{x * 100:.1f}" for x in obj.size)
    _write_four_views(
        path, spec.compile(), [f"{obj.name}, {size} cm", legend or f"{len(obj.pieces)} convex pieces", "", ""]
    )


def draw_hand(path: Path, hand: Hand) -> None:
    """Draw a hand above the table, fingers up, from four sides.

    Raises:
        FungraspError: the suffix is wrong, or the file can't be written.
    """
    pose = mounting_pose(hand)
    spec = mujoco.MjSpec()
    frame = spec.worldbody.add_frame(pos=pose[:3], quat=pose[3:])
    spec.attach(dressed_spec(hand), prefix="hand/", frame=frame)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    frame.pos[2] += max(0.0, (model.geom_rbound - data.geom_xpos[:, 2]).max())
    _write_four_views(path, spec.compile())


def _write_four_views(path: Path, model: mujoco.MjModel, labels: Sequence[str] = ()) -> None:
    check_suffix(path, "a picture", *PICTURES)
    picture = Image.fromarray(grid(four_views(model), labels, columns=2))
    with atomic_path(path) as temporary:
        picture.save(temporary)


def _shortened(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, room: float) -> str:
    text = " ".join(text.split())
    if font.getlength(text) <= room:
        return text
    while text and font.getlength(text + "…") > room:
        text = text[:-1]
    return text.rstrip() + "…"


DRAWN_GRASPS = 12
"""Largest number of grasps in a picture."""

WIDTH, HEIGHT = 400, 320
"""Size of each grasp in a picture [pixels]."""


def draw_grasps(
    path: Path,
    robot: RobotGraspSet,
    objects: Mapping[str, ObjectModel],
    human: HumanGraspSet | None = None,
    captions: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Draw up to ``DRAWN_GRASPS`` grasps, of different objects first.

    Args:
        robot: N grasps.
        human: the human grasps that they were retargeted from, drawn to their left.
        captions: text for each grasp after the name of its object; the name of the hand if None.
        progress: called with the share that is done, up to 1.

    Raises:
        FungraspError: the suffix is wrong, or the file can't be written.
    """
    check_suffix(path, "a picture", *PICTURES)
    rows = spread_rows(robot.object_name)
    images, labels = [], []
    for done, row in enumerate(rows):
        name = str(robot.object_name[row])
        marks = place_marks(robot, row, objects)
        pictures = grasp_pictures(robot, row, objects, (WIDTH, HEIGHT), human, marks)
        images += pictures
        words = robot.hand if captions is None else captions[row]
        labels += [f"{name}: human", f"{name}: {words}"][-len(pictures) :]
        progress((done + 1) / len(rows))
    with atomic_path(path) as temporary:
        Image.fromarray(grid(images, labels, columns=4)).save(temporary)


def spread_rows(object_name: np.ndarray, most: int = DRAWN_GRASPS) -> list[int]:
    """Return rows of a set: the first grasp of each object, then others. object_name: shape [N] str."""
    _, first = np.unique(object_name, return_index=True)
    others = np.setdiff1d(np.arange(len(object_name)), first)
    return [int(row) for row in np.concatenate([first, others])[:most]]


def grasp_pictures(
    grasps: HumanGraspSet | RobotGraspSet,
    row: int,
    objects: Mapping[str, ObjectModel],
    size: tuple[int, int],
    human: HumanGraspSet | None = None,
    marks: PlaceMarks | None = None,
) -> list[np.ndarray]:
    """Render one grasp with its links in the colors of ``grasp_scene``.

    Args:
        size: width and height [pixels].
        human: the human grasps that robot grasps were retargeted from; adds a picture before the robot's,
            from the same side.
        marks: contact points to draw on the robot's picture.

    Returns:
        sRGB, shape [height, width, 3] uint8 each.
    """
    grasp, (width, height) = grasps[row], size
    obj = objects[grasp.object_name]
    hand = grasps.load_hand() if isinstance(grasps, RobotGraspSet) else None
    model, qpos = grasp_scene(grasp, obj, hand)
    camera = look_at_grasp(model, qpos, width=width, height=height)
    pictures = [render(model, qpos, camera)[0]]
    if marks is not None:
        pictures = [draw_place_marks(pictures[0], camera, grasp.object_pose, marks)]
    if human is not None:
        person, still = grasp_scene(human[row], obj)
        theirs = frame_geoms(person, still, *view_angles(camera), width=width, height=height)
        pictures.insert(0, render(person, still, theirs)[0])
    return pictures


AS_SHOWN, NOT_SHOWN, HALO = (20, 150, 70), (205, 20, 45), (255, 255, 255)
"""Colors of marks that are as shown, that are not, and of their border, sRGB."""

MARKS_MEAN = "Ring: where the person touched. Dot: where the robot does. Green as shown, red not."
"""Legend of the marks."""


def draw_place_marks(
    picture: np.ndarray, camera: Camera, object_pose: np.ndarray, marks: PlaceMarks
) -> np.ndarray:
    """Draw a ring at each human contact point and a line to a dot at the robot's. The marks are drawn over
    the hand, which hides the touched surface.

    Args:
        picture: sRGB, shape [H, W, 3] uint8.
        object_pose: world frame, shape [7].

    Returns:
        a new picture of the same shape.
    """
    finer, size = 4, max(3.0, len(picture) / 80)
    whole = Image.fromarray(picture)
    layer = Image.new("RGBA", (finer * whole.width, finer * whole.height))
    draw, unit = ImageDraw.Draw(layer), finer * size
    ends = np.stack([marks.places, marks.points], axis=1)
    ends = finer * (camera.project(transform_points(object_pose, ends))[0] + 0.5)
    for color, more in ((HALO, 0.35 * unit), (None, 0.0)):
        for (ring, dot), shown in zip(ends.tolist(), marks.shown.tolist(), strict=True):
            fill = color or (AS_SHOWN if shown else NOT_SHOWN)
            draw.line([*ring, *dot], fill=fill, width=round(0.45 * unit + 2 * more))
            draw.circle(dot, 0.6 * unit + more, fill=fill)
            draw.circle(ring, unit + more, outline=fill, width=round(0.45 * unit + 2 * more))
    layer = layer.resize(whole.size, Image.Resampling.LANCZOS)
    whole.paste(layer, mask=layer)
    return np.asarray(whole)
