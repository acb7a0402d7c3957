"""Many small materials as files: a few pairs each, made by a model with some noise."""

import json
import math

import numpy as np
import torch

from torchbrdf.lobes import make_model
from torchbrdf.pairs import Pairs


def tiny_values(count, pairs=200, seed=0, noise=0.02):
    """Angles `(pairs, 3)`, radians, and values `(count, pairs, 3)` of Ward lobes of any roughness and colour."""
    generator = torch.Generator().manual_seed(seed)
    u = torch.rand(3, 1, 3 * pairs, generator=generator, dtype=torch.float64)
    theta_i, theta_o, phi = u[0, 0, :pairs] * 1.3, u[1, 0, :pairs] * 1.3, u[2, 0, :pairs] * math.pi
    theta_o[::2] = theta_i[::2] + 0.1 * (u[1, 0, :pairs][::2] - 0.5)  # half of them near the highlight
    phi[::2] = math.pi - 0.1 * u[2, 0, :pairs][::2]
    directions = [
        torch.stack([t.sin() * p.cos(), t.sin() * p.sin(), t.cos()], -1)
        for t, p in ((theta_i.abs(), 0 * phi), (theta_o.abs(), phi))
    ]
    model = make_model("ward", 1, torch.float64).batched(count)
    lambert, lobe = model.components()
    lambert.albedo.data[:] = 0.05 + 0.6 * torch.rand(count, 3, generator=generator, dtype=torch.float64)
    lobe.specular.data[:] = 0.02 + 0.3 * torch.rand(count, 3, generator=generator, dtype=torch.float64)
    lobe.roughness.data[:] = 0.08 + 0.3 * torch.rand(count, 1, generator=generator, dtype=torch.float64)
    with torch.no_grad():
        values = model(Pairs.from_directions(*directions))
    values *= 1 + noise * torch.randn(values.shape, generator=generator, dtype=torch.float64)
    return np.stack([theta_i.abs().numpy(), theta_o.abs().numpy(), phi.numpy()], -1), values.numpy()


def write_tiny(folder, count, pairs=200, seed=0):
    """So many files of columns; their paths."""
    angles, values = tiny_values(count, pairs, seed)
    folder.mkdir(parents=True, exist_ok=True)
    names = ("theta_i", "theta_o", "phi")
    paths = []
    for k, own in enumerate(values):
        columns = {name: angles[:, n].astype(np.float32) for n, name in enumerate(names)}
        columns |= {name: own[:, n].astype(np.float32) for n, name in enumerate("rgb")}
        paths.append(folder / f"m{k:06d}.npz")
        np.savez(paths[-1], **columns)
    return paths


def timeless(folder):
    """What a folder has, by name, without seconds."""
    found = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}
    for name, text in found.items():
        if name.endswith((".jsonl", ".json")):
            lines = [json.loads(line) for line in (text.splitlines() if name.endswith("l") else [text])]
            found[name] = [_timeless(line) for line in lines]
    return {name: text for name, text in found.items() if name != "fits.csv"}


def _timeless(value):
    if isinstance(value, dict):
        return {key: _timeless(item) for key, item in value.items() if key not in ("seconds", "sha256")}
    return [_timeless(item) for item in value] if isinstance(value, list) else value
