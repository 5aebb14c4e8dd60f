import mujoco
import numpy as np
import pytest
import trimesh

from fungrasp.rendering import Camera, render
from fungrasp.rendering.surfaces import mesh_surface, sample_image


def _model(mesh, texture=None):
    spec = mujoco.MjSpec()
    added = spec.add_mesh(name="thing")
    added.uservert, added.userface = mesh.vertices.ravel(), mesh.faces.ravel()
    geom = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="thing", pos=[0, 0, 0.2])
    if texture is not None:
        place, image = texture
        added.usertexcoord = place.ravel()
        height, width = image.shape[:2]
        picture = spec.add_texture(
            name="image", type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
        )
        picture.data = image.tobytes()
        spec.add_material(name="paint").textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "image"
        geom.material = "paint"
    return spec.compile()


def _on_faces(surface, rng, count):
    face = rng.integers(len(surface.corners), size=count)
    weights = rng.dirichlet(np.ones(3), count)
    corners = surface.corners[face]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return np.einsum("pc,pci->pi", weights, corners), flat


def test_normals_of_a_coarse_sphere_are_smooth():
    surface = mesh_surface(_model(trimesh.creation.icosphere(2, 0.1)), 0)
    points, flat = _on_faces(surface, np.random.default_rng(0), 500)
    normals, texture = surface.lookup(points, flat)
    truth = points / np.linalg.norm(points, axis=1, keepdims=True)
    smooth, faceted = (np.degrees(np.arccos(np.clip((n * truth).sum(1), -1, 1))) for n in (normals, flat))
    assert smooth.max() < 1.5
    assert faceted.max() > 5
    assert texture is None


def test_normals_of_a_box_stay_flat():
    surface = mesh_surface(_model(trimesh.creation.box((0.1, 0.2, 0.3))), 0)
    points, flat = _on_faces(surface, np.random.default_rng(0), 200)
    np.testing.assert_allclose(surface.lookup(points, flat)[0], flat, atol=1e-9)


def test_texture_coordinates_are_interpolated():
    mesh = trimesh.creation.icosphere(2, 0.1)
    place = 0.5 + 4.0 * mesh.vertices[:, [0, 2]]
    image = np.zeros((2, 2, 3), np.uint8)
    surface = mesh_surface(_model(mesh, (place, image)), 0)
    points, flat = _on_faces(surface, np.random.default_rng(1), 300)
    _, texture = surface.lookup(points, flat)
    model = _model(mesh)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    original = points @ rotation.reshape(3, 3).T + model.mesh_pos[0]
    assert texture == pytest.approx(0.5 + 4.0 * original[:, [0, 2]], abs=1e-5)


def test_a_texture_is_seen():
    mesh = trimesh.creation.icosphere(3, 0.1)
    place = np.stack([0.5 + 4.9 * mesh.vertices[:, 0], np.full(len(mesh.vertices), 0.5)], 1)
    image = np.zeros((1, 2, 3), np.uint8)
    image[0, 0, 0] = image[0, 1, 2] = 255
    camera = Camera((0, -0.6, 0.2), (0, 0, 0.2), fov_y=16, width=40, height=40)
    picture = render(_model(mesh, (place, image)), np.zeros(0), camera)[0].astype(int)
    assert picture[20, 12, 0] > picture[20, 12, 2] + 50
    assert picture[20, 28, 2] > picture[20, 28, 0] + 50


def test_images_are_sampled_between_pixels():
    image = np.array([[[0.0], [1.0]]])
    np.testing.assert_allclose(
        sample_image(image, np.array([[0.25, 0.5], [0.5, 0.5], [0.75, 0.5]]))[:, 0], [0, 0.5, 1], atol=1e-6
    )
