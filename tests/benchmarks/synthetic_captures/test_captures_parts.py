import numpy as np
import pytest
import trimesh
from flat_hand import FLAT_HAND

from benchmarks.synthetic_captures.camera_errors import ColorNoise, noisy_color
from benchmarks.synthetic_captures.painted_mesh import EDGE, PaintedMesh, painted_object
from benchmarks.synthetic_captures.render_capture import posed_rays
from benchmarks.synthetic_captures.skin_and_sleeve import (
    CLEARANCE,
    FOREARM,
    SKIN_TONES,
    painted_hand,
    painted_sleeve,
)
from fungrasp.media.ray_tracing import NOTHING, Look, RayTracer
from fungrasp.media.surfaces import linear
from fungrasp.objects import builtin_object
from fungrasp.perception import Intrinsics

LENS = Intrinsics(80, 60, 70, 70, 39.5, 29.5)
AT_ORIGIN = posed_rays(LENS, np.array([0, 0, 0, 1.0, 0, 0, 0]))


def a_ball(radius=0.1, center=(0, 0, 0.5), color=(0.8, 0.2, 0.2)) -> PaintedMesh:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    vertices = np.array(ball.vertices) + center
    return PaintedMesh(vertices, np.array(ball.faces), np.tile(color, (len(vertices), 1)))


def test_a_ball_is_seen_where_geometry_puts_it():
    tracer = RayTracer([a_ball().surface()], Look(light=(0, 0, -1)))
    points = tracer.see(AT_ORIGIN)
    surface = points.surface.reshape(60, 80)
    rays = LENS.rays()
    # |t r - c|^2 = R^2 for rays r with z = 1, so that t is the depth.
    rr, rc = np.sum(rays**2, -1), 0.5 * rays[..., 2]
    inside = rc**2 - rr * (0.25 - 0.01)
    distance = np.where(inside > 0, (rc - np.sqrt(np.maximum(inside, 0))) / np.sqrt(rr), np.inf)
    sure = np.abs(inside) > 2e-3
    np.testing.assert_array_equal((surface == 0)[sure], (inside > 0)[sure])
    np.testing.assert_allclose(points.distance.reshape(60, 80)[sure], distance[sure], atol=1e-3)
    assert (surface[~(inside > 0) & sure] == NOTHING).all()
    center = tracer.picture(AT_ORIGIN, points)[30, 40]
    ratio = linear(np.array([0.8, 0.2, 0.2]))
    assert center[0] / center[1] == pytest.approx(ratio[0] / ratio[1], rel=0.35)


def test_things_throw_shadows():
    floor = trimesh.creation.box((1, 1, 0.01))
    vertices = np.array(floor.vertices) + np.array([0, 0, 0.8])
    ground = PaintedMesh(vertices, np.array(floor.faces), np.ones((len(vertices), 3))).surface(0.0)
    ball = a_ball(radius=0.05, center=(0.08, 0, 0.7)).surface()
    look = Look(light=(1, 0, -1.0))
    alone, both = RayTracer([ground], look), RayTracer([ground, ball], look)
    points = both.see(AT_ORIGIN)
    seen = points.surface.reshape(60, 80)
    lit = alone.picture(AT_ORIGIN, alone.see(AT_ORIGIN))
    darker = (both.picture(AT_ORIGIN, points)[..., 0] < 0.75 * lit[..., 0]) & (seen == 0)
    columns = np.nonzero(darker)[1]
    assert len(columns) > 20
    # The light comes from the right (+x): the shadow lies to the left of the ball.
    assert columns.mean() < np.nonzero(seen == 1)[1].mean()


def test_a_hand_has_an_arm_above_the_table_and_features():
    low = FLAT_HAND + np.array([0, 0, 0.03])
    mesh, arm = painted_hand(low, SKIN_TONES[1], np.random.default_rng(0))
    edges = np.sort(mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert (count % 2 == 0).all()
    assert mesh.vertices[:, 2].min() > -0.005
    assert np.linalg.norm(mesh.vertices - low[0], axis=1).max() > 0.9 * FOREARM
    assert arm.control[1:, 2].min() >= CLEARANCE - 1e-9
    for tip in (4, 8, 12, 16, 20):
        assert np.linalg.norm(mesh.vertices - low[tip], axis=1).min() < 0.005
    # Nails: the back of a fingertip (this hand's palm is up) is paler than the back of the finger behind it.
    nail, behind = (part * low[8] + (1 - part) * low[7] for part in (0.7, 0.3))
    pale, plain = (mesh.colors[_below(mesh.vertices, point)].mean(0)[2] for point in (nail, behind))
    assert pale > plain + 0.02


def _below(vertices: np.ndarray, point: np.ndarray) -> np.ndarray:
    lower = np.flatnonzero(vertices[:, 2] < point[2] - 0.004)
    return lower[np.argsort(np.linalg.norm(vertices[lower] - point, axis=1))[:6]]


def test_a_sleeve_covers_the_arm():
    mesh, arm = painted_hand(FLAT_HAND + np.array([0, 0, 0.2]), SKIN_TONES[0], np.random.default_rng(0))
    sleeve = painted_sleeve(arm, 0.4, (0.2, 0.2, 0.4), np.random.default_rng(0))
    points, axes = arm.frame(np.array([0.6, 0.8]))
    for point, axis in zip(points, axes, strict=True):
        for surface, sign in ((mesh.vertices, -1), (sleeve.vertices, 1)):
            local = (surface - point) @ axis.T
            near = np.linalg.norm(local[np.abs(local[:, 2]) < 0.02][:, :2], axis=1)
            if sign < 0:
                widest = near.max()
            else:
                assert near.max() > widest


def test_paint_is_fine_and_always_the_same():
    mug = builtin_object("mug")
    painted = painted_object(mug)
    edges = painted.vertices[painted.faces] - painted.vertices[np.roll(painted.faces, 1, axis=1)]
    assert np.linalg.norm(edges, axis=-1).max() <= EDGE + 1e-9
    assert painted.colors.min() >= 0
    assert painted.colors.max() <= 1
    assert len(np.unique(np.round(painted.colors, 1), axis=0)) >= 3
    painted_object.cache_clear()
    np.testing.assert_array_equal(painted_object(mug).colors, painted.colors)


def test_without_noise_color_is_only_rounded():
    light = np.linspace(0, 1, 48).reshape(4, 4, 3)
    clean = noisy_color(light, ColorNoise(0.0, 0.0, 0.0), np.random.default_rng(0))
    np.testing.assert_allclose(clean, 255 * light ** (1 / 2.2), atol=0.51)
