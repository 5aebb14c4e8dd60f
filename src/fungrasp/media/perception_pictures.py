"""Pictures of a perceived grasp: overlays on the image, false-color depth, 3D views."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.geometry.poses import rotate, transform_points
from fungrasp.grasps import HumanGrasp
from fungrasp.grasps.human_hand import BONES, HUMAN_FINGERS, mirror_points
from fungrasp.media.grasp_scenes import grasp_scene
from fungrasp.media.pictures import four_views
from fungrasp.objects import ObjectModel
from fungrasp.objects.object_variants import mirrored_object
from fungrasp.perception import Capture, HandEstimate, Intrinsics
from fungrasp.perception.acceptance import SURE_JOINT
from fungrasp.perception.object_pose.object_template import MeshRays

FINGER_COLORS = {
    "index": (255, 205, 40),
    "middle": (60, 214, 125),
    "ring": (50, 180, 255),
    "pinky": (185, 130, 255),
    "thumb": (255, 80, 120),
}
"""sRGB; distinguishable for color-blind readers and different from the orange of contacts."""

ACCEPTED_LINE, REJECTED_LINE = (255, 255, 255), (255, 90, 60)
"""Outline colors of objects with an accepted and a rejected pose, sRGB."""

DEPTH_COLORS = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)])
"""Colors from far to near: dark violet to yellow, with evenly increasing brightness; sRGB."""

NO_DEPTH = np.array((25, 25, 28), np.uint8)
"""Color of pixels without depth, sRGB."""

SHAPE = (960, 720)
"""Width and height of close-ups [pixels]."""

_MARGIN, _LARGEST = 0.15, 12.0
_FINE = 2
_DARK = (20, 22, 26)


class CloseUp:
    """Enlarged part of an image around the hand and the visible part of the object, with overlays. Pictures
    are sRGB, shape [720, 960, 3] uint8."""

    def __init__(self, capture: Capture, hand: HandEstimate, model: ObjectModel, pose: np.ndarray):
        """
        Args:
            hand: camera frame.
            pose: object pose, camera frame, shape [7].
        """
        self._capture, self._hand, self._model, self._pose = capture, hand, model, pose
        lens = capture.intrinsics
        size = np.array([lens.width, lens.height], dtype=float)
        outline = lens.project(transform_points(pose, model.vertices))
        outline = outline[np.all((outline >= 0) & (outline < size), axis=1)]
        points = np.concatenate([hand.pixels, lens.project(hand.joints_camera), outline])
        points = np.clip(points[np.isfinite(points).all(axis=1)], 0, size - 1)
        low, high = points.min(axis=0), points.max(axis=0)
        whole = float(np.max(size / SHAPE))
        step = float(np.clip((1 + 2 * _MARGIN) * np.max((high - low) / SHAPE), whole / _LARGEST, whole))
        room = size - step * np.array(SHAPE)
        middle = 0.5 * (low + high - step * np.array(SHAPE))
        corner = np.where(room > 0, np.clip(middle, 0, np.maximum(room, 0)), 0.5 * room)
        self._corner, self.scale = corner, 1 / step
        """Upper left corner [pixels of the image]; pixels of the picture per pixel of the image."""

    def place(self, pixels: np.ndarray) -> np.ndarray:
        """Convert pixels of the image to pixels of the picture, shape [..., 2]."""
        return (np.asarray(pixels, dtype=float) - self._corner) * self.scale

    def directions(self, lens: Intrinsics, columns: slice, rows: slice) -> np.ndarray:
        """Return directions with z = 1 through the picture's pixels, camera frame, [rows, columns, 3]."""
        across, down = np.meshgrid(np.arange(SHAPE[0])[columns], np.arange(SHAPE[1])[rows])
        pixels = np.stack([across, down], axis=-1) / self.scale + self._corner
        return lens.deproject(pixels, np.ones(pixels.shape[:2]))

    def cut(self, image: Image.Image) -> np.ndarray:
        """Crop and enlarge an image; images of numbers (mode "F") are not interpolated."""
        how = Image.Resampling.NEAREST if image.mode == "F" else Image.Resampling.BICUBIC
        # Pillow's coordinates refer to pixel corners, ours to pixel centers.
        step = 1 / self.scale
        left, top = (float(edge + 0.5 - 0.5 * step) for edge in self._corner)
        return np.array(
            image.transform(SHAPE, Image.Transform.AFFINE, (step, 0, left, 0, step, top), resample=how)
        )

    def found(self, accepted: bool) -> np.ndarray:
        """Draw the hand's skeleton and the object's outline.

        Each finger has a color. The disc around a joint is its standard deviation; joints with low confidence
        are hollow. accepted: whether the object's pose is accepted.
        """
        picture = self._outlined(self._color(), self._pose, ACCEPTED_LINE if accepted else REJECTED_LINE)
        return _with_skeleton(picture, self, self._capture.intrinsics, self._hand)

    def another_pose(self, pose: np.ndarray) -> np.ndarray:
        """Draw the outline of the object in another pose. pose: camera frame, shape [7]."""
        return self._outlined(self._color(), pose, REJECTED_LINE)

    def depth(self, accepted: bool) -> np.ndarray:
        """Draw the depth (yellow near, violet far, black not measured) and the object's outline."""
        depth = self.cut(Image.fromarray(self._capture.depth))
        vertices = transform_points(self._pose, self._model.vertices)
        shown = np.concatenate([self._hand.joints_camera, vertices])[:, 2]
        near, far = max(float(shown.min()) - 0.03, 0.0), float(shown.max()) + 0.1
        picture = _false_colors((len(DEPTH_COLORS) - 1) * np.clip((far - depth) / (far - near), 0, 1))
        picture = np.where(depth[..., None] > 0, picture, NO_DEPTH)
        picture = self._outlined(picture, self._pose, ACCEPTED_LINE if accepted else REJECTED_LINE)
        return _with_scale(picture, near, far)

    def whole_image(self, width: int = 960) -> np.ndarray:
        """Return the color image, at most ``width`` wide, with a frame around the enlarged part."""
        image = Image.fromarray(self._capture.color)
        share = min(1.0, width / image.width)
        if share < 1:
            image = image.resize((width, round(share * image.height)), Image.Resampling.LANCZOS)
        corners = np.concatenate([self._corner, np.array(SHAPE) / self.scale + self._corner])
        box = np.clip(corners * share, 1, np.array([*image.size, *image.size]) - 2)
        draw = ImageDraw.Draw(image)
        for color, line in ((_DARK, 4), (ACCEPTED_LINE, 2)):
            draw.rectangle([float(edge) for edge in box], outline=color, width=line)
        return np.asarray(image)

    def _color(self) -> np.ndarray:
        return self.cut(Image.fromarray(self._capture.color))

    def _outlined(self, picture: np.ndarray, pose: np.ndarray, color: tuple[int, int, int]) -> np.ndarray:
        """Draw the outline of the mesh, on a darker line for contrast."""
        lens, model = self._capture.intrinsics, self._model
        corners = self.place(lens.project(transform_points(pose, model.vertices)))
        if not np.isfinite(corners).all():
            return picture
        low, high = (np.clip(corners.min(axis=0) - 2, 0, SHAPE), np.clip(corners.max(axis=0) + 3, 0, SHAPE))
        columns, rows = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
        rays = self.directions(lens, columns, rows)
        if not rays.size:
            return picture
        hit = np.zeros(picture.shape[:2])
        depth = MeshRays(model.vertices, model.faces).cast(pose[None], rays.reshape(-1, 3))
        hit[rows, columns] = np.isfinite(depth).reshape(rays.shape[:2])
        inside = np.asarray(ndimage.gaussian_filter(hit, 1.5, mode="nearest")) > 0.5
        if not inside.any() or inside.all():
            return picture
        away = np.asarray(ndimage.distance_transform_edt(inside)) - 0.5
        away += np.asarray(ndimage.distance_transform_edt(~inside))
        drawn = picture.astype(float)
        for shade, half in ((_DARK, 3.2), (color, 1.6)):
            part = np.clip(half + 0.5 - away, 0, 1)[..., None]
            drawn += part * (np.array(shade) - drawn)
        return drawn.round().astype(np.uint8)


def grasp_from_four_sides(
    grasp: HumanGrasp, model: ObjectModel, pose_world_camera: np.ndarray, mirrored: bool
) -> list[np.ndarray]:
    """Render the grasp with links in contact in orange, from the camera's side and turned by 90, 180 and 270
    degrees.

    Args:
        grasp: grasp of a right hand, world frame.
        model: the object in the image.
        pose_world_camera: shape [7].
        mirrored: whether the grasp is the reflection of the image in the plane y = 0.

    Returns:
        four pictures, sRGB, shape [360, 480, 3] uint8; none if the joints can't be drawn as a hand.
    """
    towards = -rotate(pose_world_camera[3:], np.array([0.0, 0.0, 1.0]))
    if mirrored:
        model, towards = mirrored_object(model), mirror_points(towards)
    try:
        scene, _ = grasp_scene(grasp, model)
        return four_views(scene, azimuth=float(np.degrees(np.arctan2(towards[1], towards[0]))))
    except FungraspError:
        return []


def _with_skeleton(picture: np.ndarray, view: CloseUp, lens: Intrinsics, hand: HandEstimate) -> np.ndarray:
    """Draw the skeleton at a higher resolution for smooth lines, farther parts first."""
    joints = hand.joints_camera
    places = _FINE * view.place(lens.project(joints))
    spread = np.sqrt(np.trace(hand.covariance, axis1=1, axis2=2) / 3)
    radius = _FINE * view.scale * lens.fx * spread / np.maximum(joints[:, 2], 1e-3)
    colors = [ACCEPTED_LINE, *(FINGER_COLORS[HUMAN_FINGERS[joint // 4]] for joint in range(20))]
    size = (_FINE * SHAPE[0], _FINE * SHAPE[1])
    sheet = Image.fromarray(picture).resize(size, Image.Resampling.BICUBIC)
    draw = ImageDraw.Draw(sheet, "RGBA")
    shown = np.all(np.isfinite(places), axis=1)

    def disc(joint: int, size: float, color: tuple[int, ...]) -> None:
        x, y = places[joint]
        draw.ellipse([x - size, y - size, x + size, y + size], fill=color)

    for joint in np.flatnonzero(shown).tolist():
        disc(joint, min(float(radius[joint]), sheet.height), (*colors[joint], 56))
    for near, far in sorted(BONES, key=lambda bone: -joints[list(bone), 2].mean()):
        if shown[near] and shown[far]:
            line = [tuple(places[near]), tuple(places[far])]
            for color, width in ((_DARK, 13), (colors[far], 8)):
                draw.line(line, fill=color, width=width)
    for joint in np.argsort(-joints[:, 2]).tolist():
        if shown[joint]:
            disc(joint, 13, _DARK)
            disc(joint, 10, colors[joint])
            if hand.confidence[joint] < SURE_JOINT:
                disc(joint, 5.5, _DARK)
    return np.asarray(sheet.reduce(_FINE))


def _false_colors(level: np.ndarray) -> np.ndarray:
    """Return sRGB colors, shape [..., 3] uint8. level: fractional index into ``DEPTH_COLORS``, [...]."""
    steps = np.arange(len(DEPTH_COLORS))
    colors = np.stack([np.interp(level, steps, channel) for channel in DEPTH_COLORS.T], axis=-1)
    return colors.round().astype(np.uint8)


def _with_scale(picture: np.ndarray, near: float, far: float) -> np.ndarray:
    """Draw a color bar with the depths at its ends."""
    image = Image.fromarray(picture)
    draw, font = ImageDraw.Draw(image), ImageFont.load_default(22)
    width, height = image.size
    draw.rectangle([0, height - 44, width, height], fill=_DARK)
    strip = np.tile(_false_colors(np.linspace(0, len(DEPTH_COLORS) - 1, width // 2)), (18, 1, 1))
    image.paste(Image.fromarray(strip), (width // 4, height - 31))
    for words, x, anchor in (
        (f"{far:.2f} m", width / 4 - 12, "rm"),
        (f"{near:.2f} m", 0.75 * width + 12, "lm"),
    ):
        draw.text((x, height - 22), words, fill=ACCEPTED_LINE, font=font, anchor=anchor)
    return np.asarray(image)
