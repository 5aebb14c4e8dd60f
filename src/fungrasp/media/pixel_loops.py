"""Loops over the pixels of a picture: which rays may meet something, the table top, light, edges, bytes."""

from __future__ import annotations

import numpy as np

from fungrasp.geometry.compiling import compiled, compiled_part

NOTHING, TABLE = -1, -2
"""Values of a segmentation where no surface is seen."""

TILE = 16
"""Side of the squares of pixels of which all are cast or none."""

KNEE = 0.65
"""Light above this is compressed so that what is brighter than the display keeps its hue."""

STEPS = 4095
"""Of linear light, in the table of 8-bit values."""


@compiled
def aimed_pixels(aimed, directions, eye, centers, radii):
    """Pixels whose rays may meet any of some balls: those of squares of ``TILE`` pixels of which one may.

    Args:
        aimed: out, shape [H, W] bool.
        directions: unit, shape [H, W, 3] float32.
        eye: [m], shape [3].
        centers: of the balls [m], shape [S, 3].
        radii: [m], shape [S].
    """
    height, width = aimed.shape
    # Directions to the balls, and the angles under which they are seen.
    seen, angles = np.empty((len(radii), 3)), np.empty(len(radii))
    for s in range(len(radii)):
        size = 1e-12
        for c in range(3):
            seen[s, c] = centers[s, c] - eye[c]
            size += seen[s, c] ** 2
        size = np.sqrt(size)
        for c in range(3):
            seen[s, c] /= size
        angles[s] = np.pi if radii[s] >= size else np.arcsin(radii[s] / size)
    for top in range(0, height, TILE):
        for left in range(0, width, TILE):
            bottom, right = min(top + TILE, height) - 1, min(left + TILE, width) - 1
            y, x = (top + bottom) // 2, (left + right) // 2
            # The farthest direction in the square is that of a corner.
            wide = 1e-6
            for k in range(4):
                i, j = bottom if k % 2 else top, right if k // 2 else left
                along = 0.0
                for c in range(3):
                    along += directions[y, x, c] * directions[i, j, c]
                wide = max(wide, np.arccos(min(along, 1.0)))
            hit = False
            for s in range(len(radii)):
                along = 0.0
                for c in range(3):
                    along += directions[y, x, c] * seen[s, c]
                if np.arccos(min(max(along, -1.0), 1.0)) <= angles[s] + wide + 1e-3:
                    hit = True
                    break
            for i in range(top, bottom + 1):
                for j in range(left, right + 1):
                    aimed[i, j] = hit


@compiled
def put_hits(
    surface, distance, normal, albedo, rays, directions, mesh, far, triangle, weights, normals, first, color
):
    """What rays meet: where, smooth normals that face the eye, colors of surfaces of one color.

    Args:
        surface, distance, normal, albedo: out, of all rays.
        rays: which of them were cast, shape [R] int64.
        directions: unit, of all rays, shape [P, 3] float32.
        mesh: index of the surface that is met, -1 for none, shape [R] int64.
        far: distance [m], shape [R].
        triangle: index of the triangle in its surface, shape [R] int64.
        weights: of its corners at the hit, shape [R, 3].
        normals: of the corners of the triangles of all surfaces, shape [T, 3, 3] float32.
        first: of the triangles of each surface, shape [S] int64.
        color: linear, of each surface, shape [S, 3].
    """
    for r in range(len(rays)):
        p, s = rays[r], mesh[r]
        if s < 0:
            continue
        surface[p], distance[p] = s, far[r]
        t = first[s] + triangle[r]
        x = (
            weights[r, 0] * normals[t, 0, 0]
            + weights[r, 1] * normals[t, 1, 0]
            + weights[r, 2] * normals[t, 2, 0]
        )
        y = (
            weights[r, 0] * normals[t, 0, 1]
            + weights[r, 1] * normals[t, 1, 1]
            + weights[r, 2] * normals[t, 2, 1]
        )
        z = (
            weights[r, 0] * normals[t, 0, 2]
            + weights[r, 1] * normals[t, 1, 2]
            + weights[r, 2] * normals[t, 2, 2]
        )
        size = max(np.sqrt(x * x + y * y + z * z), 1e-9)
        if x * directions[p, 0] + y * directions[p, 1] + z * directions[p, 2] > 0:
            size = -size
        normal[p, 0], normal[p, 1], normal[p, 2] = x / size, y / size, z / size
        for c in range(3):
            albedo[p, c] = color[s, c]


@compiled
def light_rays(
    origins, towards, around, rows, samples, points, eye, normals, directions, distance, light, lift
):
    """Rays from points to the key light and into the surroundings.

    Args:
        origins, towards, around: out, where the rays begin, and their directions, shape [R, 3] float32.
        rows: of the points, shape [R] int64.
        samples: of each its sample of the round light and of the half sphere, shape [R, 2] int64.
        points: samples of the unit disc, shape [N, 2].
        eye: [m], shape [3].
        normals: unit, of all points, shape [P, 3] float32.
        directions: unit, from the eye, of all points, shape [P, 3] float32.
        distance: of all points [m], shape [P].
        light: unit direction towards the key light and two axes across it, as long as its radius is wide,
            shape [3, 3].
        lift: by which rays begin above the surface [m].
    """
    for r in range(len(rows)):
        p, a, b = rows[r], samples[r, 0], samples[r, 1]
        nx, ny, nz = float(normals[p, 0]), float(normals[p, 1]), float(normals[p, 2])
        size = 0.0
        for c in range(3):
            origins[r, c] = eye[c] + distance[p] * directions[p, c] + lift * normals[p, c]
            way = light[0, c] + points[a, 0] * light[1, c] + points[a, 1] * light[2, c]
            towards[r, c] = way
            size += way * way
        for c in range(3):
            towards[r, c] /= np.sqrt(size)
        # A frame whose third axis is the normal (Duff et al. 2017).
        sign = 1.0 if nz >= 0 else -1.0
        u = -1.0 / (sign + nz)
        v = nx * ny * u
        i, j = points[b, 0], points[b, 1]
        k = np.sqrt(max(1.0 - i * i - j * j, 0.0))
        around[r, 0] = (1 + sign * nx * nx * u) * i + v * j + nx * k
        around[r, 1] = sign * v * i + (sign + ny * ny * u) * j + ny * k
        around[r, 2] = -sign * nx * i - ny * j + nz * k


@compiled
def put_table(distance, surface, normal, directions, eye, tie):
    """Let the plane z = 0 hide what is behind it.

    Args:
        distance: of what is seen [m], shape [P]; changed.
        surface: index of it, shape [P] int64; changed.
        normal: shape [P, 3] float32; changed.
        directions: unit, shape [P, 3] float32.
        eye: above the plane [m], shape [3].
        tie: distance by which a surface must be nearer than the table to be seen [m].
    """
    for p in range(len(distance)):
        down = directions[p, 2]
        if down < -1e-6:
            table = -eye[2] / min(down, -1e-9)
            if table <= distance[p] + tie:
                distance[p], surface[p] = table, TABLE
                normal[p, 0], normal[p, 1], normal[p, 2] = 0.0, 0.0, 1.0


@compiled
def shaded_table(shaded, surface, distance, directions, eye, low, high, spread):
    """Points of the table in a rectangle, widened by some pixels.

    Args:
        shaded: out, shape [P] bool.
        surface: index of what is seen, shape [P] int64.
        distance: [m], shape [P].
        directions: unit, shape [P, 3] float32.
        eye: [m], shape [3].
        low, high: corners of the rectangle [m], shape [2].
        spread: width by which it is widened, for a distance of 1 m [m].
    """
    for p in range(len(surface)):
        shaded[p] = False
        if surface[p] == TABLE:
            wide = spread * distance[p] / max(-directions[p, 2], 1e-6)
            x = eye[0] + distance[p] * directions[p, 0]
            y = eye[1] + distance[p] * directions[p, 1]
            shaded[p] = low[0] - wide < x < high[0] + wide and low[1] - wide < y < high[1] + wide


@compiled_part
def _triangle(x):
    phase = x - 2.0 * np.floor(0.5 * x)
    return min(phase, 2.0 - phase)


@compiled_part
def _soft(light):
    over = max(light - KNEE, 0.0)
    return min(light, KNEE) + (1 - KNEE) * over / (over + (1 - KNEE))


@compiled
def shade(light, surface, distance, normal, albedo, direction, received, gloss, look, places, focal):
    """Linear light that leaves points towards the eye: key light, sky and bounce from below, highlight, faint
    rim; the table's squares filtered over the width of a pixel.

    Args:
        light: out, shape [P, 3] float32.
        surface: index of what is seen, ``NOTHING`` or ``TABLE``, shape [P] int64.
        distance: of it from the eye [m], shape [P].
        normal: unit, shape [P, 3] float32.
        albedo: linear colors, shape [P, 3] float32.
        direction: unit, from the eye, shape [P, 3] float32.
        received: parts of the key light and of the surroundings that arrive, shape [P, 2] float32.
        gloss: strength and exponent of each surface's highlight, shape [S, 2].
        look: ``Look.numbers``.
        places: unit direction towards the key light, the eye, where the table does not fade [m], shape
            [3, 3].
        focal: focal length [pixels].
    """
    for p in range(len(surface)):
        s = surface[p]
        dx, dy, dz = direction[p, 0], direction[p, 1], direction[p, 2]
        shadow, openness = received[p, 0], received[p, 1]
        if s == NOTHING:
            height = min(max(1.6 * dz, 0.0), 1.0)
            for c in range(3):
                light[p, c] = _soft(look[2, c] * (1 - height) + look[3, c] * height)
        elif s == TABLE:
            x, y = places[1, 0] + distance[p] * dx, places[1, 1] + distance[p] * dy
            width = distance[p] / focal
            slant = width / max(-dz, 1e-4)
            along = np.sqrt(dx * dx + dy * dy + 1e-12)
            a, b, side = abs(dx) / along, abs(dy) / along, look[7, 0]
            u, v = max((a * slant + b * width) / side, 1e-4), max((b * slant + a * width) / side, 1e-4)
            wave = (_triangle(x / side + 0.5 * u) - _triangle(x / side - 0.5 * u)) / u
            wave *= (_triangle(y / side + 0.5 * v) - _triangle(y / side - 0.5 * v)) / v
            far = np.sqrt((x - places[2, 0]) ** 2 + (y - places[2, 1]) ** 2)
            fade = min(max((look[7, 2] - far) / (look[7, 2] - look[7, 1]), 0.0), 1.0)
            fade = fade * fade * (3 - 2 * fade)
            diffuse = max(places[0, 2], 0.0) * shadow
            for c in range(3):
                color = look[0, c] + (0.5 - 0.5 * wave) * (look[1, c] - look[0, c])
                color *= diffuse * look[4, c] + openness * look[5, c]
                light[p, c] = _soft(look[2, c] + fade * (color - look[2, c]))
        else:
            nx, ny, nz = normal[p, 0], normal[p, 1], normal[p, 2]
            facing = nx * places[0, 0] + ny * places[0, 1] + nz * places[0, 2]
            diffuse = max(facing, 0.0) * shadow
            up = 0.5 + 0.5 * nz
            hx, hy, hz = places[0, 0] - dx, places[0, 1] - dy, places[0, 2] - dz
            half = max((nx * hx + ny * hy + nz * hz) / np.sqrt(hx * hx + hy * hy + hz * hz), 0.0)
            strength, exponent = gloss[s, 0], gloss[s, 1]
            shine = half**exponent * strength * diffuse * (exponent + 8) / 60.0
            grazing = (1.0 - min(max(-(nx * dx + ny * dy + nz * dz), 0.0), 1.0)) ** 4
            sheen = grazing * openness * 0.12 * up * min(3 * strength, 1.0)
            for c in range(3):
                around = (up * look[5, c] + (1 - up) * look[6, c]) * openness
                light[p, c] = _soft(albedo[p, c] * (diffuse * look[4, c] + around) + 0.5 * shine + sheen)


@compiled
def average_over_neighbors(result, values, known, surface, distance, offsets, weights):
    """Average over the neighbors that see the same surface at about the same distance.

    Args:
        result: out, shape [H, W, 2] float32.
        values: shape [H, W, 2] float32.
        known: pixels whose values count, shape [H, W] bool.
        surface: index of what is seen; ``NOTHING`` is left as it is, shape [H, W] int64.
        distance: [m], shape [H, W].
        offsets: of rows and of columns whose pixels count [pixels], shape [K] int64.
        weights: of those rows and columns, shape [K].
    """
    height, width = surface.shape
    for y in range(height):
        for x in range(width):
            s, total, first, second = surface[y, x], 0.0, 0.0, 0.0
            flat = s < 0
            limit = 1e-6 if flat else 0.008 * distance[y, x] + 1e-6
            if s != NOTHING:
                for i in range(len(offsets)):
                    row = y + offsets[i]
                    if row < 0 or row >= height:
                        continue
                    for j in range(len(offsets)):
                        column = x + offsets[j]
                        if column < 0 or column >= width or surface[row, column] != s:
                            continue
                        if known[row, column] and (
                            flat or abs(distance[row, column] - distance[y, x]) <= limit
                        ):
                            weight = weights[i] * weights[j]
                            total += weight
                            first += weight * values[row, column, 0]
                            second += weight * values[row, column, 1]
            if total > 0:
                result[y, x, 0], result[y, x, 1] = first / total, second / total
            else:
                result[y, x, 0], result[y, x, 1] = values[y, x, 0], values[y, x, 1]


@compiled
def mark_edges(edge, surface, normal, distance):
    """Pixels beside which another surface begins, or a crease or a step of the same one.

    Args:
        edge: out, False at first, shape [H, W] bool.
        surface: index of what is seen, shape [H, W] int64.
        normal: unit, shape [H, W, 3] float32.
        distance: [m], shape [H, W].
    """
    height, width = surface.shape
    for y in range(height):
        for x in range(width):
            for k in range(2):
                i, j = y + k, x + 1 - k
                if i >= height or j >= width:
                    continue
                s = surface[y, x]
                differs = s != surface[i, j]
                if not differs and s >= 0:
                    a, b = distance[y, x], distance[i, j]
                    bend = 0.0
                    for c in range(3):
                        bend += normal[y, x, c] * normal[i, j, c]
                    differs = abs(a - b) > 0.03 * min(a, b) or bend < 0.85
                if differs:
                    edge[y, x] = edge[i, j] = True


@compiled
def nearest_alike(best, fine_surface, fine_distance, surface, distance, pixels):
    """For finer rays the pixel, of theirs and its four neighbors, that sees the same surface nearest to where
    they do.

    Args:
        best: out, shape [Q] int64.
        fine_surface: index of what the rays see, shape [Q] int64.
        fine_distance: [m], shape [Q].
        surface: of the pixels, shape [H, W] int64.
        distance: of the pixels [m], shape [H, W].
        pixels: in which the rays are, row by row, shape [Q] int64.
    """
    height, width = surface.shape
    for q in range(len(best)):
        row, column = pixels[q] // width, pixels[q] % width
        best[q], gap = pixels[q], np.inf
        for k in range(5):
            # Itself, then right, left, below and above.
            dx = (k == 1) - (k == 2)
            dy = (k == 3) - (k == 4)
            i, j = min(max(row + dy, 0), height - 1), min(max(column + dx, 0), width - 1)
            if surface[i, j] == fine_surface[q]:
                apart = 1e-4 * (dx * dx + dy * dy)
                if fine_surface[q] >= 0:
                    apart += abs(distance[i, j] - fine_distance[q])
                if apart < gap:
                    best[q], gap = i * width + j, apart


@compiled
def to_levels(result, light, table):
    """8-bit values of linear light, 1 being white.

    Args:
        result: out, shape [N] uint8.
        light: shape [N] float32.
        table: value of each of ``STEPS`` + 1 levels, shape [STEPS + 1] uint8.
    """
    for n in range(len(light)):
        result[n] = table[int(min(max(light[n] * STEPS + 0.5, 0.0), STEPS))]
