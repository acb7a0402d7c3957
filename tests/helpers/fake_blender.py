"""A stand-in for Blender's `bpy`: it knows the sockets of the Principled BSDF, and refuses everything else."""

from types import SimpleNamespace
from typing import Any

FLOAT, COLOUR = 0.0, (0.0, 0.0, 0.0, 1.0)
# By https://docs.blender.org/manual/en/5.0/render/shader_nodes/shader/principled.html and the manual of 3.6.
SOCKETS: dict[tuple[int, int], dict[str, Any]] = {
    (5, 0): {
        **dict.fromkeys(("Base Color", "Specular Tint", "Coat Tint", "Sheen Tint", "Emission Color"), COLOUR),
        **dict.fromkeys(
            (
                "Metallic", "Roughness", "IOR", "Alpha", "Diffuse Roughness", "Subsurface Weight", "Subsurface Scale",
                "Subsurface IOR", "Subsurface Anisotropy", "Specular IOR Level", "Anisotropic", "Anisotropic Rotation",
                "Transmission Weight", "Coat Weight", "Coat Roughness", "Coat IOR", "Sheen Weight", "Sheen Roughness",
                "Emission Strength", "Thin Film Thickness", "Thin Film IOR",
            ),
            FLOAT,
        ),
    },
    (3, 6): {
        **dict.fromkeys(("Base Color", "Subsurface Color", "Emission"), COLOUR),
        **dict.fromkeys(
            (
                "Subsurface", "Subsurface IOR", "Subsurface Anisotropy", "Metallic", "Specular", "Specular Tint",
                "Roughness", "Anisotropic", "Anisotropic Rotation", "Sheen", "Sheen Tint", "Clearcoat",
                "Clearcoat Roughness", "IOR", "Transmission", "Transmission Roughness", "Emission Strength", "Alpha",
            ),
            FLOAT,
        ),
    },
}  # fmt: skip


class Socket:
    """One input, whose value keeps its kind: a number, or a colour with alpha."""

    def __init__(self, value: Any) -> None:
        self.__dict__["default_value"] = list(value) if isinstance(value, tuple) else value

    def __setattr__(self, name: str, value: Any) -> None:
        assert name == "default_value", name
        if isinstance(self.default_value, list):
            value = [float(one) for one in value]
            assert len(value) == 4, value
        else:
            assert isinstance(value, float), value
        self.__dict__[name] = value


class Blender:
    """Blender of a version, with one file; `module` is what a script imports as `bpy`."""

    def __init__(self, version: tuple[int, int]) -> None:
        self.inputs = {name: Socket(value) for name, value in SOCKETS[version].items()}
        self.principled = SimpleNamespace(inputs=self.inputs, outputs={"BSDF": "the BSDF"}, distribution="MULTI_GGX")
        self.links: list[tuple[Any, Any]] = []
        self.materials: list[SimpleNamespace] = []
        self.worn: list[Any] = []
        faces = [SimpleNamespace(use_smooth=False) for _ in range(3)]
        data = SimpleNamespace(polygons=faces, materials=SimpleNamespace(append=self.worn.append))
        self.preview = SimpleNamespace(name="Sphere", data=data)
        context = SimpleNamespace(active_object=None)

        def add(**_: float) -> None:
            context.active_object = self.preview

        self.module = SimpleNamespace(
            app=SimpleNamespace(version=(*version, 0)),
            data=SimpleNamespace(materials=SimpleNamespace(new=self._material)),
            ops=SimpleNamespace(mesh=SimpleNamespace(primitive_uv_sphere_add=add)),
            context=context,
        )

    def _material(self, name: str) -> SimpleNamespace:
        nodes = SimpleNamespace(clear=lambda: None, new=self._node)
        links = SimpleNamespace(new=lambda start, end: self.links.append((start, end)))
        made = SimpleNamespace(name=name, use_nodes=False, node_tree=SimpleNamespace(nodes=nodes, links=links))
        self.materials.append(made)
        return made

    def _node(self, kind: str) -> Any:
        output = SimpleNamespace(inputs={"Surface": "the surface"})
        return {"ShaderNodeBsdfPrincipled": self.principled, "ShaderNodeOutputMaterial": output}[kind]
