"""Files as measurements come in, made up; and readings of them that share nothing with the package."""

import math
import struct
from pathlib import Path

import numpy as np

BINS = (90, 90, 180)
SCALE = np.array([1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0])


def merl_centres():
    """theta_h, theta_d and phi_d of every bin, radians."""
    h, d, p = np.meshgrid(*(np.arange(n) + 0.5 for n in BINS), indexing="ij")
    return (h / 90) ** 2 * np.pi / 2, np.radians(d), np.radians(p)


def merl_above():
    """Bins whose centre has both directions above the horizon."""
    theta_h, theta_d, phi_d = merl_centres()
    wi_z = np.cos(theta_h) * np.cos(theta_d) - np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    wo_z = np.cos(theta_h) * np.cos(theta_d) + np.sin(theta_h) * np.sin(theta_d) * np.cos(phi_d)
    return (wi_z > 0) & (wo_z > 0)


def synthetic_raw(seed=0):
    """Entries of a MERL table, (3, 90, 90, 180): noisy, 1 in 20 bins invalid in one way or another, and a big hole."""
    rng = np.random.default_rng(seed)
    theta_h, theta_d, _ = merl_centres()
    smooth = 100 + 1e5 * np.exp(-((theta_h / 0.1) ** 2)) * (1 + theta_d**5)
    raw = np.stack([smooth * rng.uniform(0.8, 1.2, BINS) for _ in range(3)])
    kind = rng.integers(0, 60, BINS)
    raw[0][kind == 0], raw[1][kind == 1], raw[2][kind == 2] = -1.0, np.nan, np.inf
    raw[:, 40:47, 20:27, 30:60] = -3.0
    raw[:, ~merl_above()] = -1.0
    return raw


def write_raw_merl(path: Path, raw, dims=BINS):
    """A MERL file, written without the package."""
    with path.open("wb") as file:
        file.write(struct.pack("<3i", *dims))
        np.ascontiguousarray(raw, "<f8").tofile(file)
    return path


def table_of(raw):
    """Values (90, 90, 180, 3) and validity of entries."""
    values = np.moveaxis(raw, 0, -1) * SCALE
    with np.errstate(invalid="ignore"):
        valid = np.isfinite(values).all(-1) & (values >= 0).all(-1) & merl_above()
    return values, valid


TYPES = {"u1": 1, "u4": 5, "i4": 6, "f4": 10, "f8": 11}


def tensor_file(fields):
    """The bytes of a tensor_file of named arrays."""
    table, offset = [], 18
    offset += sum(2 + len(name) + 2 + 1 + 8 + 8 * array.ndim for name, array in fields.items())
    for name, array in fields.items():
        entry = struct.pack("<H", len(name)) + name.encode()
        entry += struct.pack("<HBQ", array.ndim, TYPES[array.dtype.str[1:]], offset)
        table.append(entry + struct.pack(f"<{array.ndim}Q", *array.shape))
        offset += array.nbytes
    head = b"tensor_file\0" + struct.pack("<BBI", 1, 0, len(fields))
    return head + b"".join(table) + b"".join(array.tobytes() for array in fields.values())


def synthetic_bsdf(seed=0, size=8, density=16, angles=5):
    """Fields of an isotropic RGB measurement in the arrangement of the RGL database."""
    rng = np.random.default_rng(seed)
    grid = np.linspace(0, 1, density)
    theta = np.linspace(0, math.pi / 2, angles)
    lobe = np.exp(-((grid[None, None, :] - 0.3) ** 2) / 0.1) * (1.2 + np.cos(2 * np.pi * grid))[None, :, None]
    vndf = (
        lobe * (1 + 0.3 * theta[:, None, None] * grid[None, None, :]) * rng.uniform(0.5, 1, (angles, density, density))
    )
    rgb = rng.uniform(0.2, 1, (1, angles, 3, size, size)) - 0.21 * (np.arange(3) == 2)[:, None, None]
    text = np.frombuffer(b"made up", np.uint8)
    fields = {
        "version": np.array([1, 0], "u4"),
        "description": text,
        "phi_i": np.zeros(1),
        "theta_i": theta,
        "sigma": np.tile(1 - 0.9 * grid**2, (2, 1)),
        "ndf": np.tile(3 * np.exp(-3 * grid**2), (2, 1)),
        "vndf": vndf[None],
        "luminance": rng.uniform(0.2, 1, (1, angles, size, size)),
        "rgb": rgb,
        "jacobian": np.ones(1, "u1"),
    }
    return {name: value.astype("f4") if value.dtype.kind == "f" else value for name, value in fields.items()}


def read_bsdf(path: Path):
    """The fields of a tensor_file, by name."""
    data = path.read_bytes()
    (count,) = struct.unpack_from("<I", data, 14)
    names = {number: name for name, number in TYPES.items()}
    where, fields = 18, {}
    for _ in range(count):
        (length,) = struct.unpack_from("<H", data, where)
        name = data[where + 2 : where + 2 + length].decode()
        dims, kind, offset = struct.unpack_from("<HBQ", data, where + 2 + length)
        shape = struct.unpack_from(f"<{dims}Q", data, where + length + 13)
        where += length + 13 + 8 * dims
        fields[name] = np.frombuffer(data, "<" + names[kind], math.prod(shape), offset).reshape(shape)
    return fields


def brushed(wi, wo):
    """An anisotropic, reciprocal BRDF of directions `(..., 3)`: a grain along x, on grey; `(...)`."""
    h = wi + wo
    h = h / np.maximum(np.linalg.norm(h, axis=-1, keepdims=True), 1e-12)
    slope = (h[..., :2] / np.maximum(h[..., 2:], 1e-6)) / [0.5, 0.2]
    return 0.1 + np.exp(-np.square(slope).sum(-1))


def utia_directions():
    """Light and viewer of UTIA's tables, `(6, 48, 6, 48, 3)`."""
    t_i, p_i, t_o, p_o = np.radians(np.meshgrid(*2 * [np.arange(6) * 15.0, np.arange(48) * 7.5], indexing="ij"))
    pairs = ((t_i, p_i), (t_o, p_o))
    return [np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1) for t, p in pairs]


def utia(color=(1.0, 0.5, 0.25), brdf=brushed):
    """The doubles of a UTIA table, `(3, 6, 48, 6, 48)`."""
    return np.multiply.outer(np.array(color), brdf(*utia_directions()))


def anisotropic_bsdf(parts=2, size=24, azimuths=9, angles=8, brdf=brushed):
    """Fields of an anisotropic RGB measurement in RGL's arrangement, of a BRDF that has a grain along x.

    Its warp is even, D grows with the azimuth and sigma falls with the elevation, so that each of them counts.
    """
    phi = np.linspace(-math.pi, -math.pi + 2 * math.pi / parts, azimuths)
    theta = np.linspace(0, math.radians(85), angles)
    grid = np.linspace(0, 1, size)
    p_i, t_i, y, x = np.meshgrid(phi, theta, grid, grid, indexing="ij")
    theta_h, phi_h = x**2 * math.pi / 2, (2 * y - 1) * math.pi
    wi, half = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], -1)
        for t, p in ((t_i, p_i), (theta_h, phi_h))
    )
    wo = 2 * (wi * half).sum(-1, keepdims=True) * half - wi
    normals = 1 + np.cos(2 * phi_h) * np.sin(theta_h) ** 2 / 2
    visible = (1 - theta[:, None, None] / 3) * np.ones_like(t_i)
    stored = brdf(wi, wo) * wo[..., 2] * 4 * visible / normals
    unit = theta_grid = np.linspace(0, 1, 64)
    sigma = np.tile(1 - theta_grid**2 * (math.pi / 2) / 3, (2, 1))
    ndf = 1 + np.cos(2 * (2 * unit[:, None] - 1) * math.pi) * np.sin(unit**2 * math.pi / 2) ** 2 / 2
    rgb = np.multiply.outer(np.array([1.0, 0.5, 0.25]), stored)
    fields = {
        "version": np.array([1, 0], "u4"),
        "description": np.frombuffer(b"made up", np.uint8),
        "phi_i": phi,
        "theta_i": theta,
        "sigma": sigma,
        "ndf": ndf,
        "vndf": np.ones((azimuths, angles, 4, 4)),
        "luminance": np.maximum(stored, 1e-3),
        "rgb": np.moveaxis(rgb, 0, 2),
        "jacobian": np.ones(1, "u1"),
    }
    return {name: value.astype("f4") if value.dtype.kind == "f" else value for name, value in fields.items()}
