"""A mesh of random triangles."""

import numpy as np

from torchbrdf.render import Mesh


def soup(count: int = 60, seed: int = 0) -> Mesh:
    """Random triangles, of all sizes, through each other."""
    generator = np.random.default_rng(seed)
    middles = generator.uniform(-1, 1, (count, 1, 3))
    corners = middles + generator.normal(size=(count, 3, 3)) * generator.uniform(0.05, 0.8, (count, 1, 1))
    normals = generator.normal(size=(3 * count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3), normals)
