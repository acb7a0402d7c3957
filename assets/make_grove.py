"""Makes `grove.exr`, the bundled environment: a clearing among trees, with a low sun behind leaves."""

import math

import numpy as np
import torch
from torch import Tensor

_SUN = np.array([-0.55, 0.62, 0.56])
_SEED = 2012
# From octave to octave. On a plane, amplitude 1 / frequency gives all octaves the same power; leaves and bark look
# right with a little less in the fine ones.
_FALL = 0.72


def make_grove(height: int = 128, seed: int = _SEED) -> Tensor:
    """A latitude-longitude picture `(height, 2 height, 3)`, linear, about 10^4 : 1 from the sun to the darkest bark.

    Sky through a canopy, trunks, a dappled ground and a warm sun. Every texture is noise whose amplitude falls about
    as 1 / frequency, as that of natural scenes does: R. Dror et al., Statistical Characterization of Real-World
    Illumination, 2004, doi:10.1167/4.9.11. `write_exr("assets/grove.exr", make_grove().half())` made the file.
    """
    generator = np.random.default_rng(seed)
    # Drawn at twice the size and averaged, so that edges are smooth.
    polar = (np.arange(2 * height) + 0.5) * math.pi / (2 * height)
    azimuth = (np.arange(4 * height) + 0.5) * math.pi / (2 * height) - math.pi
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    directions = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1)
    elevation = np.pi / 2 - polar

    def noise(lowest: float = 2.0) -> np.ndarray:
        return _noise(directions, generator, lowest)

    from_sun = np.arccos(np.clip(directions @ (_SUN / np.linalg.norm(_SUN)), -1, 1))
    glow = np.exp(-from_sun / 0.25)[..., None]
    high = np.clip(elevation / (np.pi / 2), 0, 1)[..., None]
    sky = _mix(np.array([2.6, 2.7, 2.7]), np.array([0.9, 1.5, 2.8]), high) + 14 * glow * np.array([1.0, 0.85, 0.6])

    leaves = np.array([0.035, 0.06, 0.018]) * np.exp(0.9 * noise())[..., None]
    leaves = leaves + glow * np.array([0.5, 0.55, 0.1]) + 0.05 * high * np.array([0.6, 0.9, 0.5])
    closed = 0.9 - 0.9 * np.exp(-(((elevation - 1.5) / 0.45) ** 2)) - 0.8 * np.exp(-(((elevation - 0.1) / 0.25) ** 2))
    gaps = 0.6 * noise() + 0.9 * noise(12.0)
    picture = _mix(leaves, sky, _step(gaps - closed, 0.15))

    bark = np.array([0.05, 0.038, 0.026]) * np.exp(0.7 * noise())[..., None] * (1 + 2.5 * glow)
    picture = _mix(picture, bark, _trunks(azimuth, elevation, generator))

    ground = np.array([0.16, 0.13, 0.06]) * np.exp(0.6 * noise())[..., None]
    dapples = _step(0.6 * noise() + 0.8 * noise(10.0) - 1.7, 0.2) * np.array([1.5, 1.2, 0.7])
    horizon = -0.06 + 0.03 * noise()
    picture = _mix(picture, ground + dapples, _step(horizon - elevation, 0.02))

    through = 0.35 + 0.65 * _step(noise() + 0.5, 0.3)
    picture = picture + 260 * through * np.exp(-((from_sun / 0.045) ** 2))[..., None] * np.array([1.0, 0.82, 0.55])
    picture = picture.reshape(height, 2, 2 * height, 2, 3).mean((1, 3))
    return torch.from_numpy(picture.astype(np.float32))


def _noise(directions: np.ndarray, generator: np.random.Generator, lowest: float) -> np.ndarray:
    """Noise of variance 1 in every direction, without a seam: plane waves through the sphere, octave after octave."""
    total, power = np.zeros(directions.shape[:2]), 0.0
    frequency, amplitude = lowest, 1.0
    while frequency < 100:
        waves = generator.normal(size=(24, 3))
        waves *= frequency * generator.uniform(1, 2, size=(24, 1)) / np.linalg.norm(waves, axis=1, keepdims=True)
        phases = generator.uniform(0, 2 * np.pi, 24)
        for wave, phase in zip(waves, phases, strict=True):
            total += amplitude * np.cos(directions @ wave + phase)
        power += 24 * amplitude**2 / 2
        frequency, amplitude = 2 * frequency, amplitude * _FALL
    return total / math.sqrt(power)


def _trunks(azimuth: np.ndarray, elevation: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """How much of each direction a trunk covers; trunks lean, thin out upward and end in the canopy."""
    covered = np.zeros_like(azimuth)
    for middle in np.arange(13) * 2 * np.pi / 13 + generator.uniform(-0.2, 0.2, 13):
        lean, width, top = generator.normal(0, 0.08), generator.uniform(0.02, 0.1), generator.uniform(0.6, 1.1)
        away = azimuth - middle - lean * elevation
        away = np.abs((away + np.pi) % (2 * np.pi) - np.pi) * np.cos(elevation)
        half = width * (1.15 - 0.7 * elevation)
        covered = np.maximum(covered, _step(half - away, 0.006)[..., 0] * _step(top - elevation, 0.1)[..., 0])
    return covered[..., None]


def _step(x: np.ndarray, width: float) -> np.ndarray:
    """From 0 to 1 around x = 0, as a column for colours."""
    return (0.5 + 0.5 * np.tanh(x / width))[..., None]


def _mix(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    return first + (second - first) * share
