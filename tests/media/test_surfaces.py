import mujoco
import numpy as np
import pytest
import trimesh

from fungrasp.media.surfaces import geom_surface, linear, model_materials


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


def _surface(mesh, texture=None):
    model = _model(mesh, texture)
    return model, geom_surface(model, 0, model_materials(model))


def _on_faces(surface, rng, count):
    """Triangles, barycentric weights, positions and flat normals of random points."""
    face = rng.integers(len(surface.faces), size=count)
    weights = rng.dirichlet(np.ones(3), count)
    corners = surface.vertices[surface.faces[face]]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    return face, weights, np.einsum("pc,pci->pi", weights, corners), flat


def _normals(surface, face, weights):
    return np.einsum("pc,pci->pi", weights, surface.corner_normals[face])


def test_normals_of_a_coarse_sphere_are_smooth():
    _, surface = _surface(trimesh.creation.icosphere(2, 0.1))
    face, weights, points, flat = _on_faces(surface, np.random.default_rng(0), 500)
    normals = _normals(surface, face, weights)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    truth = points / np.linalg.norm(points, axis=1, keepdims=True)
    smooth, faceted = (np.degrees(np.arccos(np.clip((n * truth).sum(1), -1, 1))) for n in (normals, flat))
    assert smooth.max() < 1.5
    assert faceted.max() > 5
    assert surface.texture is None


def test_normals_of_a_box_stay_flat():
    _, surface = _surface(trimesh.creation.box((0.1, 0.2, 0.3)))
    face, weights, _, flat = _on_faces(surface, np.random.default_rng(0), 200)
    np.testing.assert_allclose(_normals(surface, face, weights), flat, atol=1e-6)


def test_colors_of_a_texture_are_interpolated():
    mesh = trimesh.creation.icosphere(2, 0.1)
    place = 0.5 + 4.0 * mesh.vertices[:, [0, 2]]
    image = np.zeros((1, 64, 3), np.uint8)
    image[0, :, 0] = np.arange(64) * 4
    model, surface = _surface(mesh, (place, image))
    face, weights, points, _ = _on_faces(surface, np.random.default_rng(1), 300)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.mesh_quat[0])
    u = 0.5 + 4.0 * (points @ rotation.reshape(3, 3).T + model.mesh_pos[0])[:, 0]
    truth = linear(np.interp(64 * u - 0.5, np.arange(64), np.arange(64) * 4 / 255))
    assert surface.albedo(face, weights)[:, 0] == pytest.approx(truth, abs=1e-3)


def test_a_moved_surface_takes_its_normals_along():
    _, surface = _surface(trimesh.creation.box((0.1, 0.2, 0.3)))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    moved = surface.moved(np.array([1.0, 2.0, 3.0]), turn)
    np.testing.assert_allclose(moved.vertices, surface.vertices @ turn.T + [1.0, 2.0, 3.0])
    np.testing.assert_allclose(moved.corner_normals, surface.corner_normals @ turn.T, atol=1e-6)
