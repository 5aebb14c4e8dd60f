from dataclasses import replace

import mujoco
import numpy as np
import pytest

from fungrasp.core.errors import FungraspError
from fungrasp.media import Camera, Look, Renderer, orbit_camera, render
from fungrasp.media.ray_tracing import NOTHING, TABLE, sun_direction
from fungrasp.media.surfaces import linear

SCENE = """
<mujoco>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1" rgba="1 0 0 1"/>
    <body name="ball" pos="0 0 0.05">
      <joint name="x" type="slide" axis="1 0 0"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom name="ball" type="sphere" size="0.05" rgba="0.2 0.5 0.9 1"/>
      <geom name="hull" type="box" size="0.3 0.3 0.3" group="3"/>
    </body>
    <body name="post" pos="0.12 0.08 0.06">
      <geom name="post" type="capsule" size="0.02 0.04" rgba="0.9 0.6 0.2 1"/>
    </body>
  </worldbody>
</mujoco>
"""


@pytest.fixture(scope="module")
def model():
    return mujoco.MjModel.from_xml_string(SCENE)


@pytest.fixture(scope="module")
def camera():
    return orbit_camera((0.03, 0.0, 0.05), 0.6, -60, 30, width=80, height=60)


def _geom(model, name):
    return model.geom(name).id


def test_silhouette_and_depth_of_a_sphere(model):
    camera = Camera((0.0, -0.6, 0.25), (0.0, 0.0, 0.05), fov_y=20, width=160, height=120)
    views = Renderer(model).views(np.zeros(2), camera)
    seen = views.segmentation[0] == _geom(model, "ball")
    v, u = np.mgrid[:120, :160]
    rays = camera.directions(np.stack([u, v], -1).astype(float))
    offset = np.array([0.0, 0.0, 0.05]) - camera.position
    along = rays @ offset
    squared = along**2 - offset @ offset + 0.05**2
    # The sphere is drawn as a polyhedron, which lies up to 0.2 mm inside it.
    sure = np.abs(squared) > 0.05**2 - 0.0498**2
    np.testing.assert_array_equal(seen[sure], (squared > 0)[sure])
    depth = (along - np.sqrt(np.maximum(squared, 0))) * (rays @ camera.rotation[:, 2])
    inner = squared > 0.2 * 0.05**2
    np.testing.assert_allclose(views.depth[0][inner], depth[inner], atol=5e-4)


@pytest.mark.parametrize(
    ("shape", "size", "heights"),
    [
        ("capsule", "0.02 0.03", (0.05, 0.03 + np.sqrt(0.02**2 - 0.012**2))),
        ("cylinder", "0.02 0.03", (0.03, 0.03)),
        ("ellipsoid", "0.02 0.04 0.03", (0.03, 0.03 * np.sqrt(1 - 0.36))),
        ("box", "0.02 0.04 0.03", (0.03, 0.03)),
    ],
)
def test_primitives_have_their_shape(shape, size, heights):
    """Seen from above: the top, at the middle and 12 mm from it along x; and how wide it is."""
    world = f'<worldbody><geom type="{shape}" size="{size}"/></worldbody>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco>{world}</mujoco>")
    above = Camera((0, 0, 4.0), (0, 0, 0), up=(0, 1, 0), fov_y=2, width=141, height=141)
    views = Renderer(model).views(np.zeros(0), above)
    for x, height in zip((0.0, 0.012), heights, strict=True):
        u, v = np.round(above.project(np.array([x, 0.0, height]))[0]).astype(int)
        assert views.depth[0, v, u] == pytest.approx(4.0 - height, abs=4e-4)
    columns = np.nonzero((views.segmentation[0] == 0).any(0))[0]
    width = (np.ptp(columns) + 1) * 4.0 / above.focal
    assert width == pytest.approx(0.04, abs=0.0025)


def test_depth_of_the_table_is_its_distance_along_the_view(model, camera):
    views = Renderer(model).views(np.zeros(2), camera)
    v, u = np.argwhere(views.segmentation[0] == TABLE)[-1]
    direction = camera.directions(np.array([u, v], float))
    point = np.asarray(camera.position) + direction * views.depth[0, v, u] / (
        direction @ camera.rotation[:, 2]
    )
    assert abs(point[2]) < 1e-6


def test_sky_has_no_depth_and_what_collides_is_not_drawn(model):
    camera = Camera((0, -0.6, 0.1), (0, 0, 0.2), width=20, height=16)
    views = Renderer(model).views(np.zeros(2), camera)
    sky = views.segmentation == NOTHING
    assert sky.any() and (views.depth[sky] == 0).all() and (views.depth[~sky] > 0).all()
    assert set(np.unique(views.segmentation)) <= {NOTHING, TABLE, _geom(model, "ball"), _geom(model, "post")}


def test_shadow_falls_on_the_table_opposite_to_the_light(model):
    above = Camera((0, 0, 0.8), (0, 0, 0), up=(0, 1, 0), fov_y=40, width=80, height=80)
    look = Look(light=(-1, 0, 1), table=(0.8, 0.8, 0.8), table_dark=(0.8, 0.8, 0.8))
    state = np.array([-0.1, 0.05])
    lit = render(model, state, above, look=look, shadows=False)[0].astype(int)
    shaded = render(model, state, above, look=look)[0].astype(int)
    darker = (lit - shaded).sum(-1) > 60
    spot, _ = above.project(np.array([0.0, 0.0, 0.0]))
    mirror, _ = above.project(np.array([-0.2, 0.0, 0.0]))
    u, v = np.round(spot).astype(int)
    assert darker[v, u]
    u, v = np.round(mirror).astype(int)
    assert not darker[v, u]


def test_things_darken_the_table_below_them(model):
    camera = Camera((0, -0.5, 0.3), (0, 0, 0), fov_y=30, width=80, height=60)
    look = Look(light=(0, -1, 0.2), table=(0.8, 0.8, 0.8), table_dark=(0.8, 0.8, 0.8))
    picture = render(model, np.zeros(2), camera, look=look)[0].astype(int).sum(-1)
    near, _ = camera.project(np.array([0.0, -0.04, 0.0]))
    far, _ = camera.project(np.array([-0.14, 0.0, 0.0]))
    assert (
        picture[tuple(np.round(near[::-1]).astype(int))]
        < picture[tuple(np.round(far[::-1]).astype(int))] - 10
    )


def test_same_bytes_on_any_number_of_threads_and_in_any_company(model, camera):
    states = np.stack([np.linspace(0, 0.1, 10), np.linspace(0, 0.05, 10)], axis=1)
    look = Look(light=(-1, -1, 2))
    together = render(model, states, camera, look=look, threads=2)
    np.testing.assert_array_equal(together, render(model, states, camera, look=look, threads=1))
    np.testing.assert_array_equal(together[7], render(model, states[7], camera, look=replace(look))[0])


def test_antialiasing_comes_closer_to_a_large_picture(model, camera):
    large = render(model, np.zeros(2), replace(camera, width=640, height=480), shadows=False, antialias=1)[0]
    truth = linear(large / 255).reshape(60, 8, 80, 8, 3).mean((1, 3))
    pictures = [render(model, np.zeros(2), camera, shadows=False, antialias=n)[0] for n in (1, 3)]
    rough, fine = (np.abs(linear(picture / 255) - truth).max() for picture in pictures)
    assert fine < 0.4 * rough


def test_each_frame_has_its_own_camera_and_colors(model, camera):
    other = replace(camera, position=(0.5, 0.4, 0.3))
    colors = np.stack([model.geom_rgba, model.geom_rgba])
    colors[1, _geom(model, "ball")] = (0.1, 0.9, 0.1, 1)
    colors[0, _geom(model, "post"), 3] = 0
    views = Renderer(model).views(np.zeros((2, 2)), [camera, other], geom_rgba=colors)
    ball, post = (views.segmentation == _geom(model, n) for n in ("ball", "post"))
    assert not post[0].any()
    assert post[1].any()
    assert np.argmax(views.color[0][ball[0]].mean(0)) == 2
    assert np.argmax(views.color[1][ball[1]].mean(0)) == 1
    look = Look(light=tuple(sun_direction(Look(), camera.rotation)))
    alone = next(Renderer(model, look=look).stream(np.zeros(2), other, geom_rgba=colors[1]))
    assert np.abs(views.color[1].astype(int) - alone).max() <= 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"qpos": np.zeros((2, 3))}, "qpos"),
        ({"qpos": np.full(2, np.nan)}, "finite"),
        ({"camera": []}, "cameras"),
        ({"antialias": 0}, "antialias"),
        ({"threads": -1}, "threads"),
    ],
)
def test_wrong_arguments_are_named(model, camera, arguments, words):
    with pytest.raises(FungraspError, match=words):
        render(model, **{"qpos": np.zeros(2), "camera": camera, **arguments})
    with pytest.raises(FungraspError, match="geom_rgba"):
        Renderer(model).stream(np.zeros(2), camera, geom_rgba=np.ones((2, 4)))


def test_looks_are_checked():
    with pytest.raises(FungraspError, match="table"):
        Look(table=(2, 0, 0))
    with pytest.raises(FungraspError, match="light"):
        Look(light=(0, 0, 0))
