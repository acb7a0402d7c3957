"""glTF 2.0: a mesh that wears the material, as a `.glb`.

Khronos Group, glTF 2.0 Specification, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html, with the extensions
KHR_materials_specular, KHR_materials_ior, KHR_materials_clearcoat and KHR_materials_sheen.
"""

from pathlib import Path
from typing import Any

from torchbrdf.export.base import EXPORTERS, Exported, Exporter, Material
from torchbrdf.export.shading import COLOUR, UNIT, Limits, Target, Value, Values, numbers_of
from torchbrdf.files import write_bytes
from torchbrdf.lobes import GGX, Lambert
from torchbrdf.render import Mesh, blob

# Where factors stand in a file: by the name of an extension, "" the core's. Colours are linear.
PLACES: dict[str, dict[str, Limits]] = {
    "": {"baseColorFactor": COLOUR, "metallicFactor": UNIT, "roughnessFactor": UNIT},
    "KHR_materials_ior": {"ior": Limits(1.0, 1e6)},
    "KHR_materials_specular": {"specularFactor": UNIT, "specularColorFactor": Limits(0.0, 1e6, size=3)},
    "KHR_materials_clearcoat": {"clearcoatFactor": UNIT, "clearcoatRoughnessFactor": UNIT},
    "KHR_materials_sheen": {"sheenColorFactor": COLOUR, "sheenRoughnessFactor": UNIT},
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
}
# Reflectance at normal incidence of a dielectric of index 1.5.
DEFAULT_F0 = 0.04
# What a part of the buffer is for, by OpenGL's numbers: ARRAY_BUFFER and ELEMENT_ARRAY_BUFFER.
ARRAY, ELEMENT_ARRAY = 34962, 34963
# Bytes of three numbers.
STRIDE = 12


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


@EXPORTERS.register("gltf")
class Gltf(Exporter):
    """A `.glb` of the blob, or of another mesh; its material has factors and no textures, so that no UVs are needed."""

    suffix = ".glb"
    writes_mesh = True

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the mesh with its material."""
        shading = GLTF.shading(material)
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
    """Whether an extension does something: a roughness alone, of a layer that is not there, does not."""
    return any(not name.endswith("RoughnessFactor") for name in factors)


def glb(mesh: Mesh, material: dict[str, Any]) -> bytes:
    """A binary glTF file of a mesh that wears a material.

    Args:
        mesh: Written in single precision, with its normals.
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
                for accessor in primitive["attributes"].values():  # of a sphere both share one part
                    _view(tree, accessor).update({"target": ARRAY, "byteStride": STRIDE})
                _view(tree, primitive["indices"])["target"] = ELEMENT_ARRAY
        if "extensions" in material:
            tree["extensionsUsed"] = sorted(material["extensions"])

    mesh_name = Path(mesh.name).stem
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, process=False)
    made: bytes = export_glb(trimesh.Scene(shape), include_normals=True, tree_postprocessor=wear)
    return made


def _view(tree: dict[str, Any], accessor: int) -> dict[str, Any]:
    """The part of the buffer that an accessor reads."""
    found: dict[str, Any] = tree["bufferViews"][tree["accessors"][accessor]["bufferView"]]
    return found
