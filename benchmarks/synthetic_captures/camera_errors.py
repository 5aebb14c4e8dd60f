"""Color, and depth as kinds of cameras give it: active stereo, structured light, time of flight.

A stereo camera compares windows of two infrared images. What comes of that, in this order:

- in a window that shows two surfaces the match lies between them where their disparities differ by little
  (outlines melt) and at one of the two where they differ by much, more often at the nearer, brighter one (it
  grows fatter);
- what only one of the two cameras, or only the projector and not the camera, can see has no match: a shadow
  beside near things, on one side. Filters fill part of it from both sides;
- the disparity is noisy: from pixel to pixel, in waves as wide as several windows, and by an error of
  calibration;
- dark, shiny and grazing surfaces give no match.

A time-of-flight camera has no shadow and no windows; its pixels at outlines lie between the two surfaces.

Sources: Keselman et al., "Intel RealSense Stereoscopic Depth Cameras", CVPRW 2017 (windows, subpixels);
Intel, "Depth Post-Processing for Intel RealSense Depth Camera D400 Series" (spatial and hole-filling filters)
and the D400 data sheet (baseline, reach); Khoshelham and Elberink, Sensors 2012, and Nguyen et al., 3DIMPVT
2012 (Kinect: baseline, steps of disparity, noise); Toelgyessy et al., Sensors 2021 (Azure Kinect: noise,
reach); Wasenmueller and Stricker, ACCVW 2016 (second Kinect: 1 to 2 mm below 2 m, flying pixels); Luxonis'
documentation of stereo depth (OAK-D: baseline, eighths of a pixel). What these don't say (how outlines melt,
waves, how much is filled) was chosen to meet the statistics of measured images.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image
from scipy import ndimage

from fungrasp.core.errors import FungraspError
from fungrasp.perception import Intrinsics


@dataclass(frozen=True)
class DepthCamera:
    """Errors of a kind of depth camera. Pixels are those of an image 640 wide."""

    baseline: float
    """Distance between the two cameras, or camera and projector [m]; 0: time of flight."""
    window: float
    """Width of the window that is matched [pixels]."""
    merge: float
    """Two surfaces in one window melt where their disparities differ by less than about this [pixels]."""
    fattening: float
    """How much more a near surface counts in a window than a far one; 1: as much."""
    noise: float
    """Standard deviation of the disparity from pixel to pixel [pixels]."""
    waves: float
    """Standard deviation of its slow errors [pixels]."""
    wavelength: float
    """Slow errors are alike within this distance [pixels]."""
    subpixel: float
    """Disparity is a multiple of this [pixels]; 0: of nothing."""
    axial: tuple[float, float] = (0.0, 0.0)
    """Standard deviation of the depth of a time-of-flight camera: first + second * depth^2 [m, 1/m]."""
    scale: float = 0.004
    """Standard deviation of the error of calibration, which is one for the image, as a part of depth."""
    filled: float = 0.0
    """Part of the shadows and small holes that filters fill."""
    dark: float = 0.0
    """Surfaces give nothing, in blotches, where they reflect less than about this part of the light."""
    shiny: float = 2.0
    """The same where they reflect more than about this part."""
    grazing: tuple[float, float] = (72.0, 87.0)
    """Angles between view and normal where pixels begin to give nothing, and where none is left [degrees]."""
    speckle: float = 0.001
    """Part of the surface that is lost in small holes."""
    unit: float = 0.001
    """Depth is a multiple of this [m]."""
    reach: tuple[float, float] = (0.2, 6.0)
    """Nearest and farthest depth that is measured [m]."""

    def __post_init__(self) -> None:
        if not (self.window >= 1 and self.merge > 0 and self.fattening > 0 and self.baseline >= 0):
            raise FungraspError(
                "a depth camera needs a window of 1 pixel or more, positive merge and fattening, and a "
                f"baseline that is not negative, not {self.window}, {self.merge}, {self.fattening} and "
                f"{self.baseline}"
            )


_D435I = DepthCamera(
    baseline=0.05,
    window=13.0,
    merge=8.0,
    fattening=1.6,
    noise=0.035,
    waves=0.11,
    wavelength=18.0,
    subpixel=1 / 32,
    filled=0.5,
    dark=0.004,
    shiny=1.3,
    reach=(0.2, 6.0),
)

TIME_OF_FLIGHT = DepthCamera(
    baseline=0.0,
    window=3.0,
    merge=1e3,
    fattening=1.0,
    noise=0.0,
    waves=0.0,
    wavelength=10.0,
    subpixel=0.0,
    axial=(0.001, 0.0008),
    dark=0.01,
    shiny=1.2,
    grazing=(78.0, 88.0),
    reach=(0.25, 5.5),
)
"""What all cameras that measure the time of flight have in common."""

DEPTH_CAMERAS: Mapping[str, DepthCamera] = {
    "d435i": _D435I,
    "d435i_filtered": replace(
        _D435I, window=19.0, merge=14.0, noise=0.025, filled=0.8, speckle=0.0005, dark=0.002
    ),
    "d435i_high_accuracy": replace(
        _D435I, window=9.0, merge=3.0, filled=0.05, dark=0.02, shiny=0.9, grazing=(60.0, 78.0), speckle=0.004
    ),
    "xtion": DepthCamera(
        baseline=0.075,
        window=5.0,
        merge=0.3,
        fattening=1.5,
        noise=0.05,
        waves=0.05,
        wavelength=10.0,
        subpixel=1 / 8,
        dark=0.02,
        shiny=0.9,
        grazing=(65.0, 80.0),
        speckle=0.002,
        reach=(0.4, 5.0),
    ),
    "tof": TIME_OF_FLIGHT,
    "kinect_v2": replace(
        TIME_OF_FLIGHT,
        window=5.0,
        axial=(0.0013, 0.0005),
        dark=0.015,
        shiny=1.1,
        grazing=(75.0, 87.0),
        speckle=0.002,
        reach=(0.4, 4.5),
    ),
    "oak_d": DepthCamera(
        baseline=0.075,
        window=9.0,
        merge=4.0,
        fattening=1.6,
        noise=0.08,
        waves=0.12,
        wavelength=14.0,
        subpixel=1 / 8,
        filled=0.3,
        dark=0.01,
        shiny=1.1,
        grazing=(65.0, 82.0),
        speckle=0.003,
        reach=(0.35, 8.0),
    ),
}
"""RealSense D435i with its default preset, with spatial and hole-filling filters, and with the preset "High
Accuracy"; Asus Xtion or the first Kinect; a time-of-flight camera such as Azure Kinect; the second Kinect,
whose coarser pixels mix more at outlines; OAK-D, a stereo camera without a projector."""


def camera_depth(
    depth: np.ndarray,
    intrinsics: Intrinsics,
    camera: DepthCamera,
    rng: np.random.Generator,
    brightness: np.ndarray | None = None,
) -> np.ndarray:
    """What a kind of depth camera would measure.

    Args:
        depth: true depth [m], 0 where there is nothing, shape [H, W].
        intrinsics: of the image.
        camera: the kind.
        rng: random numbers.
        brightness: light that comes from each pixel's surface, 1 for white in full light, shape [H, W];
            None: nothing is dark or shiny.

    Returns:
        [m], 0 where nothing was measured, shape [H, W] float32.
    """
    shape = depth.shape
    size = intrinsics.width / 640
    # Without a baseline one is made up: the disparity is then only a measure of nearness, in which surfaces
    # mix.
    base = (camera.baseline or 0.05) * 0.5 * (intrinsics.fx + intrinsics.fy)
    disparity = base / np.where(depth > 0, depth, np.inf)
    matched = _matched(disparity, camera, size, rng)
    shadow = _unseen_by_second(depth, base) if camera.baseline else np.zeros(shape, bool)
    if camera.baseline and camera.window > 1:
        # A window that is half in the shadow has no match either.
        shadow = ndimage.uniform_filter(shadow.astype(float), max(1, round(camera.window * size / 2))) > 0.5
    lost = (shadow & (_smooth_field(shape, 6 * size, rng) > _quantile(camera.filled))) | (
        _smooth_field(shape, 2 * size, rng) > _quantile(1 - camera.speckle)
    )
    matched = _filled(matched, shadow)
    gone = rng.uniform(size=shape) < _graze(depth, intrinsics, camera.grazing)
    # Such pixels are lost in groups, as the window sees them together.
    lost |= ndimage.uniform_filter(gone.astype(float), max(1, round(camera.window * size / 2))) > 0.5
    if brightness is not None:
        lost |= _without_match(brightness, camera, size, rng)
    matched = matched + camera.noise * size * _smooth_field(shape, 1.2 * size, rng)
    matched = matched + camera.waves * size * _smooth_field(shape, camera.wavelength * size, rng)
    if camera.subpixel:
        step = camera.subpixel * size
        matched = np.round(matched / step) * step
    measured = base / np.maximum(matched, 1e-6)
    measured = measured + (camera.axial[0] + camera.axial[1] * measured**2) * _smooth_field(
        shape, 0.6 * size, rng
    )
    measured = measured * (1 + camera.scale * rng.normal())
    measured = np.round(measured / camera.unit) * camera.unit
    lost |= (depth <= 0) | (measured < camera.reach[0]) | (measured > camera.reach[1])
    return np.where(lost, 0.0, measured).astype(np.float32)


def _matched(disparity: np.ndarray, camera: DepthCamera, size: float, rng: np.random.Generator) -> np.ndarray:
    """Disparity as windows see it: between the surfaces in the window, or one of them."""
    width = camera.window * size
    if width <= 1:
        return disparity
    reach = 2 * int(width / 2) + 1
    low, high = ndimage.minimum_filter(disparity, reach), ndimage.maximum_filter(disparity, reach)
    # What has more contrast in the window counts more; that differs from place to place.
    contrast = np.exp(0.5 * _smooth_field(disparity.shape, width / 3, rng))
    sigma = width / 4
    mean = ndimage.gaussian_filter(contrast * disparity, sigma) / ndimage.gaussian_filter(contrast, sigma)
    apart = high - low
    part = np.clip((mean - low) / np.maximum(apart, 1e-9), 1e-6, 1 - 1e-6)
    # One surface alone, bent or sloped, is only smoothed; two whose matches don't overlap compete.
    sharp = 1.0 + (apart / (camera.merge * size)) ** 2
    favor = np.log(camera.fattening) * (1 - 1 / sharp)
    logit = sharp * (np.log(part) - np.log1p(-part) + favor)
    return low + apart / (1 + np.exp(-np.clip(logit, -60, 60)))


def _filled(disparity: np.ndarray, shadow: np.ndarray) -> np.ndarray:
    """Disparity with shadows bridged along the rows, as filters fill them."""
    filled = disparity.copy()
    columns = np.arange(disparity.shape[1])
    for row in np.flatnonzero(shadow.any(axis=1)):
        there = ~shadow[row]
        if there.any():
            filled[row] = np.interp(columns, columns[there], disparity[row, there])
    return filled


def _without_match(
    brightness: np.ndarray, camera: DepthCamera, size: float, rng: np.random.Generator
) -> np.ndarray:
    """Pixels of dark and shiny surfaces that give nothing."""
    light = ndimage.gaussian_filter(brightness, camera.window * size / 4)
    blotches = np.exp(0.4 * _smooth_field(brightness.shape, 5 * size, rng))
    return (light * blotches < camera.dark) | (light * blotches > 2 * camera.shiny)


def _quantile(part: float) -> float:
    """What a normally distributed number is below with this probability."""
    from scipy.special import ndtri

    return float(ndtri(part))


def _smooth_field(shape: tuple[int, ...], width: float, rng: np.random.Generator) -> np.ndarray:
    """Normally distributed, neighbors alike within ``width`` pixels."""
    field = ndimage.gaussian_filter(rng.normal(size=shape), width, mode="wrap")
    return field / field.std()


def _unseen_by_second(depth: np.ndarray, disparity: float) -> np.ndarray:
    """Pixels that the second camera, to the right of the first, can't see. disparity: of 1 m [pixels]."""
    # A pixel is occluded for the second camera where another one to its right lands left of it there.
    place = np.arange(depth.shape[1]) - disparity / np.maximum(depth, 0.1)
    nearest = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    ahead = np.concatenate([nearest[:, 1:], np.full((len(depth), 1), np.inf)], axis=1)
    return ahead < place - 0.5


def _graze(depth: np.ndarray, intrinsics: Intrinsics, limits: tuple[float, float]) -> np.ndarray:
    """Chance that a pixel gives nothing as the surface is seen from the side, shape [H, W]."""
    points = intrinsics.rays() * depth[..., None]
    across, down = np.gradient(points, axis=1), np.gradient(points, axis=0)
    normal = np.cross(across, down)
    size = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    cosine = np.abs(np.einsum("hwi,hwi->hw", normal, points)) / np.maximum(size, 1e-12)
    angle = np.degrees(np.arccos(np.clip(cosine, 0, 1)))
    return np.clip((angle - limits[0]) / (limits[1] - limits[0]), 0, 1)


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
