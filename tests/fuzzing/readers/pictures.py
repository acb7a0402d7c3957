"""Light probes and meshes."""

from functools import cache
from pathlib import Path

import numpy as np
import OpenEXR
import torch

from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_formats import MESHES, exr, hdr
from fuzzing.readers import Reader
from fuzzing.sane import check_finite, expect, later
from torchbrdf.images import read_image
from torchbrdf.render import Environment, Scene, find_mesh, sphere
from torchbrdf.render.light import environment

# Texels along a side of an environment's map; the 512 that it usually has take seconds.
environment.RESOLUTION = 16


def _picture() -> np.ndarray:
    source = np.random.default_rng(0)
    picture = source.uniform(0, 1, (16, 32, 3)).astype(np.float32)
    picture[:, 8:20] = 0.25  # which run lengths shorten
    picture[4, 5] = 1000
    return picture


def make_exr(folder: Path, compression: OpenEXR.Compression = OpenEXR.ZIP_COMPRESSION) -> None:
    header = {"compression": compression, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(_picture())}).write(str(folder / "fuzzed.exr"))


def make_plain_exr(folder: Path) -> None:
    """Whose pixels are there as they are, so that changed bytes are changed values."""
    make_exr(folder, OpenEXR.NO_COMPRESSION)


def make_hdr(folder: Path) -> None:
    """New-style run lengths, as most programs write them."""
    picture = _picture()
    exponent = np.ceil(np.log2(picture.max(-1) + 1e-9)).astype(int)
    mantissa = np.clip(picture / np.exp2(exponent)[..., None] * 256, 0, 255).astype(np.uint8)
    rgbe = np.concatenate([mantissa, (exponent + 128)[..., None].astype(np.uint8)], -1)
    rows = b""
    for row in rgbe:
        rows += bytes((2, 2, 0, 32))
        for channel in row.T:
            values = channel.tolist()
            start = 0
            while start < 32:
                run = next((n for n in range(1, 32 - start) if values[start + n] != values[start]), 32 - start)
                rows += bytes((128 + run, values[start])) if run > 1 else bytes((1, values[start]))
                start += run
    head = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\nEXPOSURE=1.5\n\n-Y 16 +X 32\n"
    (folder / "fuzzed.hdr").write_bytes(head + rows)


def use_picture(path: Path) -> None:
    """As a light uses it."""
    picture = read_image(path)
    expect(picture.dim() == 3 and picture.shape[-1] == 3 and picture.dtype == torch.float32, "no picture (H, W, 3)")
    light = Environment.from_file(path)
    check_finite(light.texels, "radiance")
    expect(bool((light.texels >= 0).all()), "radiance below 0")
    lights = light.light_samples(16)
    check_finite(lights.flux, "flux")
    check_finite(lights.direction, "direction")
    found = light.lookup(torch.tensor([[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]]), torch.tensor([0.1, 3.0]))
    check_finite(found, "lookup")


@cache
def _blobs() -> dict[str, bytes]:
    """A bumpy sphere in every format, with normals and two materials where the format has them."""
    import trimesh

    source = np.random.default_rng(0)
    small = sphere(2)
    vertices = small.vertices * (1 + 0.1 * source.uniform(size=(len(small.vertices), 1)))
    mesh = trimesh.Trimesh(vertices, small.faces, vertex_normals=small.normals, process=False)
    made = {
        "ply": mesh.export(file_type="ply", vertex_normal=True),
        "stl": mesh.export(file_type="stl"),
        "off": mesh.export(file_type="off"),
        "glb": trimesh.Scene({"a": mesh, "b": mesh.copy()}).export(file_type="glb"),
        "obj": _obj(vertices, small.normals, small.faces),
    }
    return {name: data.encode() if isinstance(data, str) else bytes(data) for name, data in made.items()}


def _obj(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray) -> str:
    lines = [f"v {x:.5f} {y:.5f} {z:.5f}" for x, y, z in vertices]
    lines += [f"vn {x:.5f} {y:.5f} {z:.5f}" for x, y, z in normals]
    half = len(faces) // 2
    for name, part in (("red", faces[:half]), ("blue", faces[half:])):
        lines += [f"usemtl {name}", *(f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in part + 1)]
    return "\n".join(lines) + "\n"


def _make_mesh(kind: str, folder: Path) -> None:
    (folder / f"fuzzed.{kind}").write_bytes(_blobs()[kind])


def use_mesh(path: Path) -> None:
    """As a picture uses it."""
    mesh = find_mesh(str(path))
    check_finite(torch.from_numpy(mesh.vertices), "vertices")
    expect(mesh.faces.ndim == 2 and mesh.faces.shape[1] == 3 and len(mesh.faces) > 0, "no triangles")
    expect(mesh.faces.min() >= 0 and mesh.faces.max() < len(mesh.vertices), "a face names no vertex")
    length = np.linalg.norm(mesh.normals[np.unique(mesh.faces)], axis=1)
    expect(np.allclose(length, 1, atol=1e-3), f"normals not of length 1: {length.min():g} to {length.max():g}")
    center, radius = mesh.bounding_sphere
    expect(np.isfinite(center).all() and np.isfinite(radius) and radius > 0, "no bounding sphere")
    with later():
        scene = Scene(mesh, environment=_light(), size=8, nodes=8, light_samples=4)
        check_finite(scene.transport @ torch.ones(1, len(scene.pairs), 3), "picture")


@cache
def _light() -> Environment:
    return Environment.from_image(torch.ones(16, 32, 3))


def _mesh_reader(kind: str) -> Reader:
    changes = MESHES[kind] + (TEXT if kind in ("obj", "off", "ply") else ())
    return Reader(
        kind, f"fuzzed.{kind}", lambda folder: _make_mesh(kind, folder), use_mesh, changes, share=0.7, renamed=True
    )


READERS = (
    Reader("hdr", "fuzzed.hdr", make_hdr, use_picture, (hdr, hdr), renamed=True),
    Reader("exr", "fuzzed.exr", make_exr, use_picture, (exr, exr), renamed=True),
    Reader("exr-plain", "fuzzed.exr", make_plain_exr, use_picture, (exr,), renamed=True),
    *(_mesh_reader(kind) for kind in MESHES),
)
