"""A small made-up surface and what was seen of it."""

from dataclasses import dataclass

import numpy as np
import pytest

from torchbrdf.texels import SyntheticSurface, dome, synthetic_surface


@dataclass(frozen=True)
class Scene:
    """A surface of 16 x 16 texels under 24 lights."""

    surface: SyntheticSurface
    lights: np.ndarray
    stack: np.ndarray
    true_errors: np.ndarray


@pytest.fixture(scope="session")
def scene():
    surface, lights = synthetic_surface(16, seed=1), dome(24)
    whole = slice(0, 16)
    return Scene(surface, lights, surface.stack(lights), surface.camera(lights).true_errors(whole, whole))
