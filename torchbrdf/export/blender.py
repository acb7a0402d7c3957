"""Blender: a script that makes a material of a Principled BSDF and a sphere that wears it.

Blender Foundation, Blender 5.0 Manual, Principled BSDF,
https://docs.blender.org/manual/en/latest/render/shader_nodes/shader/principled.html.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from torch import Tensor

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material, has_grain
from torchbrdf.export.mtlx import conductor, diffuse, ggx, inputs_of
from torchbrdf.export.shading import COLOUR, UNIT, Limits, Target, Values
from torchbrdf.lobes import GGX, GGXAnisotropic, OpenPBR, OpenPBRAnisotropic
from torchbrdf.lobes.fresnel import schlick
from torchbrdf.lobes.openpbr import below_coat, darkening, eta_below_coat

# The sockets of Blender 4.0 and later that a material of reflections alone has, and what they may be.
SOCKETS: dict[str, Limits] = {
    "Base Color": COLOUR,
    "Metallic": UNIT,
    "Roughness": UNIT,
    "IOR": Limits(1.0, 1000.0),
    "Diffuse Roughness": UNIT,
    "Specular IOR Level": UNIT,
    "Specular Tint": COLOUR,
    "Coat Weight": UNIT,
    "Coat Roughness": UNIT,
    "Coat IOR": Limits(1.0, 4.0),
    "Coat Tint": COLOUR,
    "Sheen Weight": UNIT,
    "Sheen Roughness": UNIT,
    "Sheen Tint": COLOUR,
    "Anisotropic": UNIT,
    "Anisotropic Rotation": UNIT,
}
# 1 - the least quotient of both widths.
LARGEST_ANISOTROPY = 0.9
# Those that say the same as an input of OpenPBR.
SAME = {
    "base_color": "Base Color",
    "base_diffuse_roughness": "Diffuse Roughness",
    "base_metalness": "Metallic",
    "specular_color": "Specular Tint",
    "specular_roughness": "Roughness",
    "specular_ior": "IOR",
    "coat_weight": "Coat Weight",
    "coat_color": "Coat Tint",
    "coat_roughness": "Coat Roughness",
    "coat_ior": "Coat IOR",
    "fuzz_weight": "Sheen Weight",
    "fuzz_color": "Sheen Tint",
    "fuzz_roughness": "Sheen Roughness",
}


# Blender's names before 4.0; a socket that was a number there and is a colour since has none. Its specular of 0.5 is a
# reflectance of 0.04 at normal incidence, whatever the index of refraction.
OLDER = {
    "Specular IOR Level": "Specular",
    "Coat Weight": "Clearcoat",
    "Coat Roughness": "Clearcoat Roughness",
    "Sheen Weight": "Sheen",
}


def sockets(inputs: Values) -> Values:
    """The sockets for inputs of OpenPBR, which Blender's node is made after.

    A level of 0.5 leaves the reflection of the index of refraction as it is; so it is half of OpenPBR's weight.
    """
    found = {SAME[name]: value for name, value in inputs.items() if name in SAME}
    weight = inputs.get("specular_weight", 1.0)
    return found | {"Specular IOR Level": weight / 2 if isinstance(weight, float) else 0.5}


def grain(along: float, across: float, rotation: float) -> Values:
    """Sockets of a grain, of alpha along and across its x axis.

    Blender's wide direction has alpha = roughness^2 / aspect, the other one roughness^2 aspect, where
    aspect = sqrt(1 - 0.9 anisotropic): B. Burley, Physically-Based Shading at Disney, 2012, as Cycles has it. Its
    rotation counts turns.
    """
    narrow, wide = min(along, across), max(along, across)
    turn = rotation if along > across else rotation + math.pi / 2
    return {
        "Roughness": (narrow * wide) ** 0.25,
        "Anisotropic": (1 - narrow / wide) / LARGEST_ANISOTROPY,
        "Anisotropic Rotation": turn % math.pi / (2 * math.pi),
    }


def sockets_with_grain(lobe: OpenPBRAnisotropic) -> Values:
    """The sockets for OpenPBR with a grain: those without it, with two roughnesses, which a coat makes larger."""
    along, across = lobe.specular_roughness_x.item() ** 2, lobe.specular_roughness_y.item() ** 2
    own = {name: getattr(lobe, name).detach() for name in lobe.parameter_specs if name in OpenPBR.parameter_specs}
    roughness = ((along**2 + across**2) / 2) ** 0.25
    plain = sockets(inputs_for_blender(OpenPBR(**own, specular_roughness=roughness)))
    rougher = float(plain["Roughness"]) ** 2 / roughness**2  # type: ignore[arg-type]
    return plain | grain(along * rougher, across * rougher, lobe.rotation.item())


def inputs_for_blender(lobe: OpenPBR) -> Values:
    """OpenPBR's inputs with what Blender's node does not do done to them.

    A metal's weight goes into the base colour and into the tint at 82 degrees, in its share: F at the normal and there
    is that of OpenPBR. A coat makes the base rougher, changes its index of refraction, and darkens it by what it throws
    back.
    """
    values = {name: getattr(lobe, name).detach() for name in lobe.parameter_specs}
    weight, coat, coat_ior = (values[name] for name in ("specular_weight", "coat_weight", "coat_ior"))
    metalness, color, tint = (values[name] for name in ("base_metalness", "base_color", "specular_color"))
    lower = tint * weight * _at_82_degrees(color) / _at_82_degrees(weight * color)
    found = inputs_of(lobe) | {
        "base_color": ((1 + metalness * (weight - 1)) * color).tolist(),
        "specular_color": (tint + metalness * (lower - tint)).tolist(),
    }
    if not coat.item() > 0:
        return found
    alpha = below_coat(values["specular_roughness"], coat, values["coat_roughness"])
    left = darkening(**values) * (1 + coat * (values["coat_color"] - 1))
    return found | {
        "specular_roughness": alpha.sqrt().item(),
        "specular_ior": eta_below_coat(weight, values["specular_ior"], coat, coat_ior).item(),
        "specular_weight": 1.0,
        "coat_color": (1 + (left - 1) / coat).clamp(0, 1).tolist(),
    }


def _at_82_degrees(f0: Tensor) -> Tensor:
    """Schlick's F where the cosine is 1/7, of which the tint is a factor."""
    return schlick(f0, f0.new_tensor(1 / 7))


def _diffuse(lobe: Any) -> Values:
    return sockets(diffuse(lobe))


def _metal(inputs: Values | None) -> Values | None:
    """A metal whose reflection is scaled by nothing, since Blender has no weight for that."""
    return sockets(inputs) if inputs is not None and inputs["specular_weight"] == 1 else None


BLENDER = Target(
    title="Blender's Principled BSDF",
    limits=SOCKETS,
    model="openpbr",
    translated=lambda lobe: sockets(inputs_for_blender(lobe)),
    differs="as OpenPBR, whose picture is compared, but its layers are mixed in a way of its own",
    simple={
        "lambert": _diffuse,
        "ggx": lambda lobe: _metal(ggx(lobe)),
        "ggx_f82": lambda lobe: _metal(conductor(lobe)),
    },
    name="blender",
)


def _brushed(lobe: GGXAnisotropic) -> Values | None:
    """A metal with a grain."""
    straight = _metal(ggx(GGX(specular=lobe.specular.detach(), roughness=0.5, f0=lobe.f0.detach())))
    if straight is None:
        return None
    return straight | grain(lobe.roughness_x.item(), lobe.roughness_y.item(), lobe.rotation.item())


WITH_GRAIN = replace(
    BLENDER,
    model="openpbr_anisotropic",
    translated=sockets_with_grain,
    simple={**BLENDER.simple, "ggx_anisotropic": _brushed},
)


@EXPORTERS.register("blender")
class Blender(Exporter):
    """A script for `blender --python FILE`."""

    suffix = ".py"

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the script."""
        shading = (WITH_GRAIN if has_grain(material) else BLENDER).shading(material)
        return shading.write(material.path(folder, self.suffix), script(shading.values, material.name))


def script(values: Values, name: str) -> str:
    """The text of a script.

    Args:
        values: By the names of sockets in Blender 4.0 and later.
        name: Of the material.
    """
    now = {key: (*value, 1.0) if isinstance(value, list) else value for key, value in values.items()}
    older = {key: (OLDER[key], now[key]) for key in OLDER if key in now}
    level, ior = values.get("Specular IOR Level", 0.5), values.get("IOR", 1.5)
    if "Specular IOR Level" in older and isinstance(level, float) and isinstance(ior, float):
        f0 = 2 * level * ((ior - 1) / (ior + 1)) ** 2
        older["Specular IOR Level"] = ("Specular", min(round(f0 / 0.08, 7), 1.0))
    return TEMPLATE.format(name=ascii(name), sockets=_rows(now), older=_rows(older))


def _rows(values: dict[str, Any]) -> str:
    return "".join(f"\n    {key!r}: {value!r}," for key, value in values.items())


TEMPLATE = '''\
"""A material for Blender, and a sphere that wears it: blender --python FILE. Written by torchbrdf.

Colours are linear, with the primaries of Rec. 709, as Blender's sockets have them.
"""

import bpy

NAME = {name}
SOCKETS = {{{sockets}
}}
# The name and the value before Blender 4.0.
OLDER = {{{older}
}}


def make_material():
    material = bpy.data.materials.new(NAME)
    if bpy.app.version < (5, 0):  # since then every material has nodes
        material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    principled = nodes.new("ShaderNodeBsdfPrincipled")
    output = nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    material.node_tree.links.new(principled.outputs["BSDF"], output.inputs["Surface"])
    principled.distribution = "GGX"  # without scattering between facets
    for name, value in SOCKETS.items():
        if name not in principled.inputs:
            name, value = OLDER.get(name, (name, value))
        socket = principled.inputs.get(name)
        if socket is None or hasattr(socket.default_value, "__len__") != isinstance(value, tuple):
            print(f"{{NAME}}: this Blender has no {{name}}; left out")
        else:
            socket.default_value = value
    return material


def make_preview(material):  # above the cube of a new file
    bpy.ops.mesh.primitive_uv_sphere_add(segments=64, ring_count=32, radius=1.0, location=(0.0, 0.0, 2.2))
    preview = bpy.context.active_object
    preview.name = NAME
    for face in preview.data.polygons:
        face.use_smooth = True
    preview.data.materials.append(material)


make_preview(make_material())
'''
