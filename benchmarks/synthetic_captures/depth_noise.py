"""What a real depth camera does to a perfect picture: noise, holes and quantisation."""

from __future__ import annotations

import io
from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy import ndimage

from fungrasp.perception import Intrinsics


@dataclass(frozen=True)
class DepthNoise:
    """Errors of an active stereo camera; the defaults are of the kind sold for robots (5 cm baseline)."""

    baseline: float = 0.05
    """Distance between the two infrared cameras [m]; what the second one can't see has no depth."""
    disparity: float = 0.08
    """Standard deviation of the disparity [pixels]: noise is depth^2 * disparity / (focal * baseline)."""
    blob: float = 1.2
    """Neighboring pixels this near share their noise [pixels]."""
    edge: float = 0.6
    """Standard deviation of how far edges are displaced [pixels]."""
    dropout: float = 0.35
    """Part of the pixels beside a step in depth that give nothing."""
    step: float = 0.015
    """Difference in depth between neighboring pixels that counts as an edge [m]."""
    grazing: tuple[float, float] = (68.0, 86.0)
    """Angles between view and normal where pixels begin to give nothing, and where none is left [degrees]."""
    speckle: float = 0.002
    """Part of the surface that is lost in small holes."""
    step_size: float = 0.001
    """Depth is a multiple of this [m]."""
    reach: tuple[float, float] = (0.17, 6.0)
    """Nearest and farthest depth that is measured [m]."""


@dataclass(frozen=True)
class ColorNoise:
    """Errors of a small color camera."""

    noise: float = 2.0
    """Standard deviation of a pixel in mid gray [of 255]."""
    blur: float = 0.45
    """Standard deviation of the lens's blur [pixels]."""
    balance: float = 0.05
    """Largest error of the white balance and, times four, of the exposure, as a part."""
    exposure: tuple[float, float] | None = None
    """Range of factors of the light, evenly on a logarithmic scale, where skin is to be over- or
    underexposed; None: as ``balance`` says."""
    motion: float = 0.0
    """Longest way that the camera moves while the shutter is open [pixels]."""
    jpeg: tuple[int, int] | None = None
    """Range of JPEG qualities with which the picture is coded, 1 to 95; None: it is not."""


def noisy_depth(
    depth: np.ndarray, intrinsics: Intrinsics, noise: DepthNoise, rng: np.random.Generator
) -> np.ndarray:
    """What a depth camera would measure.

    Args:
        depth: true depth [m], 0 where there is nothing, shape [H, W].
        intrinsics: of the image.
        noise: how bad the camera is.
        rng: random numbers.

    Returns:
        [m], 0 where nothing was measured, shape [H, W] float32.
    """
    shape = depth.shape
    rows, columns = np.mgrid[: shape[0], : shape[1]]
    rows = np.clip(np.round(rows + noise.edge * smooth_field(shape, 0.7, rng)).astype(int), 0, shape[0] - 1)
    columns = np.clip(
        np.round(columns + noise.edge * smooth_field(shape, 0.7, rng)).astype(int), 0, shape[1] - 1
    )
    focal = 0.5 * (intrinsics.fx + intrinsics.fy)
    lost = unseen_by_second(depth, focal * noise.baseline)
    lost |= rng.uniform(size=shape) < graze(depth, intrinsics, noise.grazing)
    lost |= smooth_field(shape, 2.5, rng) > _normal_quantile(1 - noise.speckle)
    steps = ndimage.maximum_filter(depth, 3) - ndimage.minimum_filter(depth, 3) > noise.step
    lost |= steps & (rng.uniform(size=shape) < noise.dropout)
    measured = depth[rows, columns]
    lost = lost[rows, columns] | (measured < noise.reach[0]) | (measured > noise.reach[1])
    sigma = measured**2 * noise.disparity / (focal * noise.baseline)
    measured = measured + sigma * smooth_field(shape, noise.blob, rng)
    measured = np.round(measured / noise.step_size) * noise.step_size
    return np.where(lost, 0.0, measured).astype(np.float32)


def noisy_color(light: np.ndarray, noise: ColorNoise, rng: np.random.Generator) -> np.ndarray:
    """What a color camera would make of linear light.

    Args:
        light: shape [H, W, 3].
        noise: how bad the camera is.
        rng: random numbers.

    Returns:
        sRGB, shape [H, W, 3] uint8.
    """
    light = light * (1 + noise.balance * rng.uniform(-1, 1, 3)) * (1 + 4 * noise.balance * rng.uniform(-1, 1))
    if noise.exposure is not None:
        low, high = np.log(noise.exposure)
        light = light * np.exp(rng.uniform(low, high))
    if noise.motion:
        light = _moved(light, rng.uniform(0, noise.motion), rng.uniform(0, np.pi))
    light = ndimage.gaussian_filter(light, (noise.blur, noise.blur, 0))
    # Shot noise grows with the root of the light, which the gamma curve evens out.
    picture = 255 * np.clip(light, 0, 1) ** (1 / 2.2) + noise.noise * rng.normal(size=light.shape)
    picture = np.clip(np.round(picture), 0, 255).astype(np.uint8)
    if noise.jpeg is None:
        return picture
    coded = io.BytesIO()
    Image.fromarray(picture).save(coded, "JPEG", quality=int(rng.integers(noise.jpeg[0], noise.jpeg[1] + 1)))
    return np.array(Image.open(coded))


def _moved(light: np.ndarray, way: float, angle: float) -> np.ndarray:
    """The mean of the picture along a way [pixels] in a direction [rad]."""
    steps = int(np.ceil(way)) + 1
    shifts = np.linspace(-0.5, 0.5, steps)[:, None] * way * np.array([np.sin(angle), np.cos(angle)])
    moved = [ndimage.shift(light, (*shift, 0), order=1, mode="nearest") for shift in shifts]
    return np.mean(moved, axis=0)


def smooth_field(shape: tuple[int, ...], width: float, rng: np.random.Generator) -> np.ndarray:
    """Normally distributed, neighbors alike within ``width`` pixels."""
    field = ndimage.gaussian_filter(rng.normal(size=shape), width, mode="wrap")
    return field / field.std()


def _normal_quantile(part: float) -> float:
    from scipy.special import ndtri

    return float(ndtri(part))


def unseen_by_second(depth: np.ndarray, disparity: float) -> np.ndarray:
    """Pixels that the second camera, to the right of the first, can't see. disparity: of 1 m [pixels]."""
    # A pixel is occluded for the second camera where another one to its right lands left of it there.
    place = np.arange(depth.shape[1]) - disparity / np.maximum(depth, 0.1)
    nearest = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    ahead = np.concatenate([nearest[:, 1:], np.full((len(depth), 1), np.inf)], axis=1)
    return ahead < place - 0.5


def graze(depth: np.ndarray, intrinsics: Intrinsics, limits: tuple[float, float]) -> np.ndarray:
    """Chance that a pixel gives nothing as the surface is seen from the side, shape [H, W]."""
    points = intrinsics.rays() * depth[..., None]
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(across, down)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    cosine = np.abs(np.einsum("hwi,hwi->hw", normal, points)) / np.maximum(size, 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return np.clip((angle - limits[0]) / (limits[1] - limits[0]), 0, 1)
