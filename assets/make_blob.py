"""Makes `blob.ply`, the bundled object: a sphere with smooth bumps and hollows."""

import numpy as np

from torchbrdf.render.raster.mesh import Mesh, octahedral_sphere

# Bumps (above 0) and hollows (below 0) of the blob: direction, height, concentration.
BUMPS = np.array(
    [
        (0.15, 1.00, 0.20, 0.34, 5.0),
        (-0.85, 0.50, 0.35, 0.38, 7.0),
        (0.75, 0.45, 0.55, 0.34, 8.0),
        (-0.15, -0.10, 1.00, 0.30, 9.0),
        (0.30, -0.85, 0.55, 0.36, 7.0),
        (-0.75, -0.60, 0.30, 0.36, 7.0),
        (0.95, -0.30, -0.10, 0.36, 7.0),
        (0.45, 0.50, -0.80, 0.34, 6.0),
        (-0.45, 0.15, -0.95, 0.36, 6.0),
        (0.15, -0.60, -0.80, 0.36, 6.0),
        (0.25, 0.45, 0.90, -0.12, 14.0),
        (-0.70, -0.05, 0.75, -0.14, 12.0),
        (0.50, -0.20, 0.85, -0.14, 12.0),
    ]
)


def make_blob(levels: int = 6) -> Mesh:
    """A sphere d -> r(d) d with r = 1 + sum of a exp(k (d.c - 1)), smooth bumps a > 0 and hollows a < 0 about axes c.

    Star-shaped, so it cannot cut through itself. The normal is r d - grad r, with grad r along the sphere.
    `make_blob().save("assets/blob.ply")` made the file.
    """
    directions, faces = octahedral_sphere(levels)
    axes = BUMPS[:, :3] / np.linalg.norm(BUMPS[:, :3], axis=1, keepdims=True)
    height, concentration = BUMPS[:, 3], BUMPS[:, 4]
    along = directions @ axes.T
    bumps = height * np.exp(concentration * (along - 1))
    radius = 1 + bumps.sum(1, keepdims=True)
    slopes = bumps * concentration
    gradient = slopes @ axes - (slopes * along).sum(1, keepdims=True) * directions
    normals = radius * directions - gradient
    return Mesh(radius * directions, faces, normals / np.linalg.norm(normals, axis=1, keepdims=True))
