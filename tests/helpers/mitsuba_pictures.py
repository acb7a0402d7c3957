"""The same pictures by Mitsuba 3: the object, camera and environment of a Scene, in direct light.

W. Jakob et al., Mitsuba 3 renderer, 2022, https://mitsuba-renderer.org.
"""

import math
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from helpers.measured_files import BINS, SCALE, merl_above
from torchbrdf.images import DIFFERENCES, ToneMap
from torchbrdf.pairs import Pairs
from torchbrdf.render import Camera, Environment, Mesh
from torchbrdf.render.light.punctual import PointLight, PunctualLight

VARIANT = "llvm_ad_rgb"
# Mitsuba's Dr.Jit ends the process with an older one.
_OLDEST_LLVM = 19
# A picture of a ball; only drawing shows whether LLVM is new enough.
_ATTEMPT = f"""
import mitsuba as mi
mi.set_variant("{VARIANT}")
parts = {{"a": "sphere", "b": "constant", "c": "direct", "d": "perspective"}}
scene = mi.load_dict({{"type": "scene", **{{name: {{"type": kind}} for name, kind in parts.items()}}}})
mi.render(scene, spp=1).numpy()
"""
# Rays at a time; bounds the memory.
_WAVE = 1 << 21
# The environment for Mitsuba: 0.18 degrees, half a texel of ours.
_WIDTH = 2048

Bsdf = dict[str, Any]
# Index of refraction of a metal.
METAL = (0.2, 3.0)


class Likeness(NamedTuple):
    """How alike two pictures are: dB after tone mapping, the ratio of their means, and the dB that Mitsuba's noise
    alone would leave."""

    psnr: float
    ratio: float
    noise: float


@cache
def obstacle() -> str | None:
    """Why Mitsuba cannot draw here, or None. Finds it out in a process of its own, since that might be aborted."""
    if "DRJIT_LIBLLVM_PATH" not in os.environ:
        # libLLVM.so.19.1, libLLVM.so.20, ...: up to 18 the number is in front of ".so".
        numbers = {path: re.fullmatch(r"libLLVM\.so\.(\d+)\.(\d+)", path.name) for path in Path("/usr/lib").glob("*/*")}
        found = {path: (int(match[1]), int(match[2])) for path, match in numbers.items() if match}
        newest = max(found, key=found.__getitem__, default=None)
        if newest is None or found[newest][0] < _OLDEST_LLVM:
            return f"Mitsuba's {VARIANT} needs LLVM {_OLDEST_LLVM} or newer in /usr/lib, or DRJIT_LIBLLVM_PATH"
        os.environ["DRJIT_LIBLLVM_PATH"] = str(newest)
    done = subprocess.run([sys.executable, "-c", _ATTEMPT], capture_output=True, text=True)
    if done.returncode:
        last = done.stderr.strip().splitlines()[-1] if done.returncode > 0 else f"ended by signal {-done.returncode}"
        return f"Mitsuba's {VARIANT} does not work here: {last}"
    return None


def mitsuba() -> ModuleType:
    """Mitsuba, ready to draw."""
    import mitsuba as mi

    mi.set_variant(VARIANT)
    _register(VARIANT)
    return mi


def diffuse(albedo: float) -> Bsdf:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": albedo}}


def conductor(alpha: float) -> Bsdf:
    """That reflects everything: `beckmann(alpha)` is the same on Pairs."""
    return {"type": "roughconductor", "material": "none", "distribution": "beckmann", "alpha": alpha}


def brushed(alpha_u: float, alpha_v: float) -> Bsdf:
    """That reflects everything, with a grain: `RoughConductorAnisotropic` with a large k is the same on Pairs."""
    rough = {"type": "roughconductor", "distribution": "ggx", "alpha_u": alpha_u, "alpha_v": alpha_v}
    return {**rough, "eta": METAL[0], "k": METAL[1]}


def lathe() -> Bsdf:
    """The unit sphere whose parallels, along which u grows, are level."""
    return {"type": "sphere", "to_world": mitsuba().ScalarTransform4f().rotate([1, 0, 0], -90)}


def table(path: Path, alpha: float) -> Bsdf:
    """A MERL table; alpha: about how rough it is, for choosing directions only."""
    return {"type": "merl_table", "filename": str(path), "alpha": alpha}


class Beckmann:
    """Mitsuba's rough conductor with Fresnel's factor 1: Walter et al. 2007, doi:10.2312/EGWR/EGSR07/195-206,
    eq. 25 and, for the shadowing, 27."""

    def __init__(self, alpha: float) -> None:
        self.alpha = alpha

    def __call__(self, pairs: Pairs) -> Tensor:
        cos_i, cos_o = pairs.cos_i.clamp_min(1e-6), pairs.cos_o.clamp_min(1e-6)
        facets = torch.exp(-pairs.tan2_h / self.alpha**2) * (1 + pairs.tan2_h).square() / (math.pi * self.alpha**2)
        value = facets * self._shadowing(cos_i) * self._shadowing(cos_o) / (4 * cos_i * cos_o)
        return torch.where(pairs.above_horizon, value, 0)[..., None].expand(*pairs.shape, 3)

    def _shadowing(self, cosine: Tensor) -> Tensor:
        a = cosine / (self.alpha * (1 - cosine.square()).clamp_min(1e-12).sqrt())
        return torch.where(a < 1.6, (3.535 * a + 2.181 * a * a) / (1 + 2.276 * a + 2.577 * a * a), 1)


class Studio:
    """A mesh, a view and light in Mitsuba: pictures of size x size pixels, of those that are in `where`.

    centers: look at the middle of each pixel, as our pictures do; else at random points of it. shape: what stands in
    the mesh's place in Mitsuba.
    """

    def __init__(
        self,
        mesh: Mesh,
        camera: Camera,
        light: Environment | Sequence[PunctualLight],
        where: Tensor,
        centers: bool = True,
        shape: Bsdf | None = None,
    ) -> None:
        self.mesh, self.where, self.centers, self.shape = mesh, where, centers, shape
        mi = mitsuba()
        eye, axes = camera.pose(mesh)
        sensor = {
            "type": "perspective",
            "fov": camera.field_of_view,
            "to_world": mi.ScalarTransform4f().look_at(origin=list(eye), target=list(eye - axes[2]), up=list(axes[1])),
            "film": {"type": "hdrfilm", "width": len(where), "height": len(where)},
        }
        lights = (
            [_surroundings(mi, light)]
            if isinstance(light, Environment)
            else [_punctual(punctual_light) for punctual_light in light]
        )
        self._sensor = mi.load_dict(sensor)
        self._integrator = mi.load_dict({"type": "direct", "hide_emitters": True})
        self._lights = {f"light{k}": mi.load_dict(one) for k, one in enumerate(lights)}

    def picture(self, bsdf: Bsdf, samples: int, seed: int = 0) -> Tensor:
        """Linear, `(size, size, 3)`, 0 elsewhere; samples: paths a pixel, a square number, spread evenly."""
        import drjit as dr

        mi = mitsuba()
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "mesh.ply"
            self.mesh.save(path)
            shape = self.shape or {"type": "ply", "filename": str(path)}
            scene = mi.load_dict({"type": "scene", "object": {**shape, "bsdf": bsdf}, **self._lights})
        sampler = mi.load_dict({"type": "multijitter", "sample_count": samples})
        count, size = sampler.sample_count(), len(self.where)
        sampler.set_samples_per_wavefront(count)
        picture = torch.zeros(size**2, 3)
        for number, index in enumerate(self.where.flatten().nonzero()[:, 0].split(max(_WAVE // count, 1))):
            sampler.seed(seed * size**2 + number, count * len(index))
            pixel = dr.repeat(mi.UInt32(index.numpy().astype(np.uint32)), count)
            within = mi.Point2f(0.5) if self.centers else sampler.next_2d()
            place = (mi.Point2f(pixel % size, pixel // size) + within) / size
            ray, _ = self._sensor.sample_ray_differential(0, 0.5, place, mi.Point2f(0.5))
            light, _, _ = self._integrator.sample(scene, sampler, ray)
            mean = np.array(light).reshape(3, -1, count).mean(-1, dtype=np.float64)
            picture[index] = torch.from_numpy(mean.T).to(torch.float32)
        return picture.reshape(size, size, 3)


def likeness(ours: Tensor, pair: Sequence[Tensor], where: Tensor) -> Likeness:
    """Of our picture to the mean of a pair by Mitsuba with different seeds, `(size, size, 3)`, in some pixels."""
    first, second = pair
    theirs = (first + second) / 2
    tone, psnr = ToneMap.from_images(theirs, where), DIFFERENCES["psnr"]()
    found = psnr(tone(ours)[None], tone(theirs)[None], where)
    # The mean of two has a quarter of the variance of their difference.
    noise = psnr(tone(first)[None], tone(second)[None], where) + 20 * math.log10(2)
    return Likeness(found.item(), (ours[where].mean() / theirs[where].mean()).item(), noise.item())


def _surroundings(mi: ModuleType, environment: Environment) -> dict[str, Any]:
    """Our environment: a latitude-longitude picture whose first row is at the upper pole, and the last at the lower."""
    theta = torch.linspace(0, math.pi, _WIDTH // 2, dtype=torch.float64)[:, None]
    phi = ((torch.arange(_WIDTH, dtype=torch.float64) + 0.5) / _WIDTH * 2 - 1) * math.pi
    directions = torch.stack([theta.sin() * phi.sin(), theta.cos().expand(-1, _WIDTH), -theta.sin() * phi.cos()], -1)
    picture = environment.lookup(directions.to(torch.float32), torch.full(directions.shape[:2], 1e-9))
    # The middle of its picture is +z, that of ours -z.
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 180)
    return {"type": "envmap", "bitmap": mi.Bitmap(picture.numpy()), "to_world": turn}


def _punctual(punctual_light: PunctualLight) -> dict[str, Any]:
    if isinstance(punctual_light, PointLight):
        return {"type": "point", "position": list(punctual_light.position), "intensity": _rgb(punctual_light.intensity)}
    # Its direction is that in which the light goes.
    away = [-x for x in punctual_light.direction]
    return {"type": "directional", "direction": away, "irradiance": _rgb(punctual_light.irradiance)}


def _rgb(color: Any) -> dict[str, Any]:
    return {"type": "rgb", "value": list(color)}


@cache
def _register(variant: str) -> None:
    """Make MERL tables known to Mitsuba, from their description alone and without this package's reading of them.

    Between the centres of bins linear, from the neighbours that are valid; theta_h, theta_d and phi_d as in
    S. Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation, 1998.
    """
    import drjit as dr
    import mitsuba as mi

    class Table(mi.BSDF):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            entries = np.fromfile(props["filename"], "<f8", offset=12).reshape(3, *BINS)
            valid = (entries >= 0).all(0) & merl_above()
            rows = np.concatenate([np.where(valid, entries * SCALE[:, None, None, None], 0), valid[None]])
            self._rows = mi.Float(rows.reshape(4, -1).T.ravel().astype(np.float32))
            self._facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, props["alpha"], False)
            self.m_components = [mi.BSDFFlags.GlossyReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def _value(self, wi: Any, wo: Any) -> Any:
            half = dr.normalize(wi + wo)
            theta_h = dr.atan2(dr.sqrt(half.x**2 + half.y**2), half.z)
            phi_h = dr.atan2(half.y, half.x)
            # wi, turned by -phi_h about the normal, then by -theta_h about the bitangent
            x = wi.x * dr.cos(phi_h) + wi.y * dr.sin(phi_h)
            y = wi.y * dr.cos(phi_h) - wi.x * dr.sin(phi_h)
            x, z = x * dr.cos(theta_h) - wi.z * dr.sin(theta_h), x * dr.sin(theta_h) + wi.z * dr.cos(theta_h)
            phi_d = dr.atan2(y, x)
            phi_d = dr.select(phi_d < 0, phi_d + math.pi, phi_d)
            theta_d = dr.atan2(dr.sqrt(x * x + y * y), z)
            place = dr.sqrt(theta_h * 2 / math.pi) * 90, dr.rad2deg(theta_d), dr.rad2deg(phi_d)
            corners = [(mi.UInt32(0), mi.Float(1))]
            for along, count in zip(place, BINS, strict=True):
                at = dr.clip(along - 0.5, 0, count - 1)
                low = dr.minimum(mi.UInt32(at), count - 2)
                share = at - mi.Float(low)
                ends = ((low, 1 - share), (low + 1, share))
                corners = [(row * count + end, weight * part) for row, weight in corners for end, part in ends]
            found = sum((weight * dr.gather(mi.Vector4f, self._rows, row) for row, weight in corners), mi.Vector4f(0))
            return mi.Color3f(found.xyz) / dr.maximum(found.w, 1e-6)

        def eval(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            above = (si.wi.z > 0) & (wo.z > 0)
            return dr.select(active & above, self._value(si.wi, wo) * wo.z, 0)

        def pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            half = dr.normalize(si.wi + wo)
            by_facets = self._facets.pdf(si.wi, half) / (4 * dr.dot(half, wo))
            above = (si.wi.z > 0) & (wo.z > 0)
            return dr.select(active & above, 0.5 * wo.z / math.pi + 0.5 * by_facets, 0)

        def sample(self, ctx: Any, si: Any, sample1: Any, sample2: Any, active: Any = True) -> Any:
            # Half of the evenly spread samples for either kind.
            first = sample2.x < 0.5
            place = mi.Point2f(2 * sample2.x - dr.select(first, 0, 1), sample2.y)
            half, _ = self._facets.sample(si.wi, place)
            spread = mi.warp.square_to_cosine_hemisphere(place)
            sampled = dr.zeros(mi.BSDFSample3f)
            sampled.wo = dr.select(first, spread, mi.reflect(si.wi, half))
            sampled.pdf = self.pdf(ctx, si, sampled.wo, active)
            sampled.eta = 1.0
            sampled.sampled_type = mi.UInt32(+mi.BSDFFlags.GlossyReflection)
            sampled.sampled_component = mi.UInt32(0)
            value = self.eval(ctx, si, sampled.wo, active)
            return sampled, dr.select(sampled.pdf > 0, value / sampled.pdf, 0)

        def eval_pdf(self, ctx: Any, si: Any, wo: Any, active: Any = True) -> Any:
            return self.eval(ctx, si, wo, active), self.pdf(ctx, si, wo, active)

    mi.register_bsdf("merl_table", Table)
