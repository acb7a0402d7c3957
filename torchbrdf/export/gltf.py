"""glTF 2.0: a mesh that wears the material, as a `.glb`.

Khronos Group, glTF 2.0 Specification, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, with the extensions
KHR_materials_specular, KHR_materials_ior, KHR_materials_clearcoat, KHR_materials_sheen and KHR_materials_anisotropy.
"""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material, has_grain
from torchbrdf.export.shading import COLOUR, UNIT, Limits, Target, Value, Values, numbers_of
from torchbrdf.files import write_bytes
from torchbrdf.lobes import GGX, GGXAnisotropic, Lambert
from torchbrdf.render import Mesh, blob

# Where factors stand in a file: by the name of an extension, "" the core's. Colours are linear.
PLACES: dict[str, dict[str, Limits]] = {
    "": {"baseColorFactor": COLOUR, "metallicFactor": UNIT, "roughnessFactor": UNIT},
    "KHR_materials_ior": {"ior": Limits(1.0, 1e6)},
    "KHR_materials_specular": {"specularFactor": UNIT, "specularColorFactor": Limits(0.0, 1e6, size=3)},
    "KHR_materials_clearcoat": {"clearcoatFactor": UNIT, "clearcoatRoughnessFactor": UNIT},
    "KHR_materials_sheen": {"sheenColorFactor": COLOUR, "sheenRoughnessFactor": UNIT},
    "KHR_materials_anisotropy": {"anisotropyStrength": UNIT, "anisotropyRotation": Limits(0.0, math.pi)},
}
# The factors by the parameters of the lobe.
FACTORS = {
    "base_color": "baseColorFactor",
    "metallic": "metallicFactor",
    "roughness": "roughnessFactor",
    "ior": "ior",
    "specular": "specularFactor",
    "specular_color": "specularColorFactor",
    "clearcoat": "clearcoatFactor",
    "clearcoat_roughness": "clearcoatRoughnessFactor",
    "sheen_color": "sheenColorFactor",
    "sheen_roughness": "sheenRoughnessFactor",
}
# What a file means that does not say it, of which there is no need to say more.
DEFAULTS: Values = {
    "ior": 1.5,
    "specularFactor": 1.0,
    "specularColorFactor": [1.0, 1.0, 1.0],
    "clearcoatFactor": 0.0,
    "sheenColorFactor": [0.0, 0.0, 0.0],
    "anisotropyStrength": 0.0,
}
# Reflectance at normal incidence of a dielectric of index 1.5.
DEFAULT_F0 = 0.04
# What a part of the buffer is for, by OpenGL's numbers: ARRAY_BUFFER and ELEMENT_ARRAY_BUFFER.
ARRAY, ELEMENT_ARRAY = 34962, 34963
# Bytes of the three numbers of a vertex or a normal, and of the four of a tangent.
STRIDES = {"VEC3": 12, "VEC4": 16}


def _lambert(lobe: Lambert) -> Values:
    """A dielectric that reflects nothing but its base."""
    return {
        "baseColorFactor": numbers_of(lobe.albedo),
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
        "specularFactor": 0.0,
    }


def _ggx(lobe: GGX) -> Values | None:
    """Without a colour: a metal, or a dielectric with a black base, F0 = 0.04 colour factor and F90 = factor."""
    specular, alpha, f0 = lobe.specular.tolist(), lobe.roughness.item(), lobe.f0.item()
    if max(specular) != min(specular):
        return None
    if specular[0] == 1:
        return {"baseColorFactor": [f0] * 3, "metallicFactor": 1.0, "roughnessFactor": alpha**0.5}
    return {
        "baseColorFactor": [0.0] * 3,
        "metallicFactor": 0.0,
        "roughnessFactor": alpha**0.5,
        "specularFactor": specular[0],
        "specularColorFactor": [f0 / DEFAULT_F0] * 3,
    }


def _conductor(lobe: Any) -> Values | None:
    """Schlick's Fresnel from a coloured F0 to white, which has no tint: a metal."""
    if lobe.weight.item() != 1 or bool((lobe.f82 != 1).any()):
        return None
    return {
        "baseColorFactor": numbers_of(lobe.f0),
        "metallicFactor": 1.0,
        "roughnessFactor": lobe.roughness.item() ** 0.5,
    }


def _ggx_with_grain(lobe: GGXAnisotropic) -> Values | None:
    """The same with the grain of GGX."""
    along, across = lobe.roughness_x.item(), lobe.roughness_y.item()
    straight = _ggx(GGX(specular=lobe.specular.detach(), roughness=min(along, across), f0=lobe.f0.detach()))
    return None if straight is None else straight | _grain(along, across, lobe.rotation.item())


def _grain(along: float, across: float, rotation: float) -> Values:
    """Strength and direction of a grain, of alpha along and across its x axis.

    The extension names the wide direction, which has alpha = mix(a, 1, strength^2), where a = roughness^2 is that of
    the narrow one, which runs along the scratches.
    """
    narrow, wide = min(along, across), max(along, across)
    strength = math.sqrt((wide - narrow) / (1 - narrow)) if wide > narrow else 0.0
    turn = rotation if along > across else rotation + math.pi / 2
    return {
        "roughnessFactor": math.sqrt(narrow),
        "anisotropyStrength": strength,
        "anisotropyRotation": turn % math.pi,
    }


def _own_with_grain(lobe: Any) -> Values:
    """The lobe has glTF's own parameters, but for those of the grain."""
    along, across = lobe.roughness_x.item() ** 2, lobe.roughness_y.item() ** 2
    others = {FACTORS[name]: numbers_of(getattr(lobe, name)) for name in lobe.parameter_specs if name in FACTORS}
    return others | _grain(along, across, lobe.rotation.item())


def _own(lobe: Any) -> Values:
    """The lobe has glTF's own parameters."""
    return {FACTORS[name]: numbers_of(getattr(lobe, name)) for name in lobe.parameter_specs}


GLTF = Target(
    title="glTF's metallic-roughness material",
    limits={name: limits for place in PLACES.values() for name, limits in place.items()},
    model="gltf",
    translated=_own,
    differs="",
    simple={"lambert": _lambert, "ggx": _ggx, "ggx_f82": _conductor},
    name="gltf",
)

WITH_GRAIN = replace(
    GLTF,
    title="glTF's metallic-roughness material with KHR_materials_anisotropy",
    model="gltf_anisotropic",
    translated=_own_with_grain,
    simple={**GLTF.simple, "ggx_anisotropic": _ggx_with_grain},
)


@EXPORTERS.register("gltf")
class Gltf(Exporter):
    """A `.glb` of the blob, or of another mesh; its material has factors and no textures, so that no UVs are needed.

    A mesh whose material has a grain has tangents: its own, or the level ones, as in our own pictures.
    """

    suffix = ".glb"
    writes_mesh = True

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the mesh with its material."""
        shading = (WITH_GRAIN if has_grain(material) else GLTF).shading(material)
        path = material.path(folder, self.suffix)
        write_bytes(path, glb(self.mesh or blob(), gltf_material(shading.values, material.name)))
        return Exported([path], shading.exact, shading.notes, shading.shown)


def gltf_material(values: Values, name: str) -> dict[str, Any]:
    """The JSON of a glTF material.

    Args:
        values: Factors by their names in glTF, `baseColorFactor` without alpha.
        name: Of the material.

    Returns:
        The material, with the extensions that it needs; both sides are seen, as in our own pictures.

    Example:
        >>> made = gltf_material({"baseColorFactor": [1.0, 0.5, 0.0], "metallicFactor": 0.0, "ior": 1.5}, "paint")
        >>> made["pbrMetallicRoughness"]
        {'baseColorFactor': [1.0, 0.5, 0.0, 1.0], 'metallicFactor': 0.0}
    """
    said = {name: value for name, value in values.items() if value != DEFAULTS.get(name)}
    parts = {place: {key: said[key] for key in limits if key in said} for place, limits in PLACES.items()}
    core: dict[str, Any] = parts.pop("")
    if "baseColorFactor" in core:
        core["baseColorFactor"] = [*core["baseColorFactor"], 1.0]
    extensions = {place: factors for place, factors in parts.items() if _matters(factors)}
    made = {"name": name, "pbrMetallicRoughness": core, "doubleSided": True}
    return made | ({"extensions": extensions} if extensions else {})


def _matters(factors: dict[str, Value]) -> bool:
    """Whether an extension does something: a roughness or a rotation alone, of what is not there, does not."""
    return any(not name.endswith(("RoughnessFactor", "Rotation")) for name in factors)


def glb(mesh: Mesh, material: dict[str, Any]) -> bytes:
    """A binary glTF file of a mesh that wears a material.

    Args:
        mesh: Written in single precision, with its normals; with tangents where the material has a grain.
        material: As `gltf_material` makes it.
    """
    import trimesh
    from trimesh.exchange.gltf import export_glb

    def wear(tree: dict[str, Any]) -> None:
        tree["materials"] = [material]
        for part in tree["meshes"]:
            part["name"] = mesh_name
            for primitive in part["primitives"]:
                primitive["material"] = 0
                own = primitive["attributes"]
                if "_TANGENT" in own:  # trimesh writes attributes that it does not know with a line in front
                    own["TANGENT"] = own.pop("_TANGENT")
                for accessor in own.values():  # of a sphere vertices and normals share one part
                    stride = STRIDES[tree["accessors"][accessor]["type"]]
                    _view(tree, accessor).update({"target": ARRAY, "byteStride": stride})
                _view(tree, primitive["indices"])["target"] = ELEMENT_ARRAY
        if "extensions" in material:
            tree["extensionsUsed"] = sorted(material["extensions"])

    mesh_name = Path(mesh.name).stem
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False)
    if "KHR_materials_anisotropy" in material.get("extensions", {}):
        shape.vertex_attributes["_TANGENT"] = _tangents(mesh).astype(np.float32)
    made: bytes = export_glb(trimesh.Scene(shape), include_normals=True, tree_postprocessor=wear)
    return made


def _tangents(mesh: Mesh) -> np.ndarray:
    """Unit tangents, and 1 for a bitangent that is normal x tangent, `(V, 4)`."""
    return np.concatenate([mesh.unit_tangents(), np.ones((len(mesh.vertices), 1))], 1)


def _view(tree: dict[str, Any], accessor: int) -> dict[str, Any]:
    """The part of the buffer that an accessor reads."""
    found: dict[str, Any] = tree["bufferViews"][tree["accessors"][accessor]["bufferView"]]
    return found
