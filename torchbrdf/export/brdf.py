"""Disney's BRDF Explorer: GLSL with parameters to turn.

B. Burley, Physically Based Shading at Disney, 2012 (SIGGRAPH course); https://github.com/wdas/brdf.
"""

import importlib.resources
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import ClassVar

from torch import Tensor

from torchbrdf.export.base import EXPORTERS, Brdf, Exported, Exporter, Material, numbers, refuse_grain
from torchbrdf.files import write_text
from torchbrdf.lobes import LOBES, Lobe
from torchbrdf.lobes.parameter import BoundedParameter

SHADERS = "shaders"
# No lobe has such a name.
COMMON = "shared-functions"
FUNCTION = """\
vec3 BRDF(vec3 L, vec3 V, vec3 N, vec3 X, vec3 Y)
{{
    Pair p = pair_of(L, V, N, X, Y);
    if (p.cos_i <= 0.0 || p.cos_o <= 0.0) return vec3(0.0);
    return {sum};
}}
"""


@EXPORTERS.register("brdf")
class BrdfExplorer(Exporter):
    """A `.brdf` file where every lobe has GLSL, see `shaders/`; else a MERL table, which BRDF Explorer reads, too."""

    suffix: ClassVar[str] = ".brdf"
    beside: ClassVar[tuple[str, ...]] = (".binary",)

    def write(self, material: Material, folder: Path) -> Exported:
        """Write the GLSL, or the table."""
        names = shader_names(material.brdf)
        if names is None or not isinstance(material.brdf, Lobe):
            refuse_grain(material, "brdf", "not all of its lobes have GLSL, and a MERL table has no room for it")
            return EXPORTERS["merl"]().write(material, folder)
        path = material.path(folder, self.suffix)
        write_text(path, to_glsl(material.brdf, names))
        return Exported([path], True, [f"exact: {' + '.join(names)} as GLSL"], material.brdf)


def shader_names(brdf: Brdf) -> list[str] | None:
    """The names of a model's components, if all of them have GLSL."""
    if not isinstance(brdf, Lobe):
        return None
    names = [str(LOBES.name_of(type(component))) for component in brdf.components()]
    return names if all(glsl(name) for name in names) else None


@cache
def glsl(name: str) -> str:
    """The GLSL of a lobe, `name(Pair, parameters...)`; "" if it has none."""
    file = importlib.resources.files(__package__) / SHADERS / f"{name}.glsl"
    return file.read_text(encoding="utf-8") if file.is_file() else ""


def to_glsl(model: Lobe, names: Sequence[str]) -> str:
    """The text of a `.brdf` file, whose parameters are named after those of the lobes, and numbered."""
    parameters: list[str] = []
    constants: list[str] = []
    calls = []
    for number, (component, name) in enumerate(zip(model.components(), names, strict=True), 1):
        for own, spec in component.parameter_specs.items():
            line = _declared(f"{own}_{number}", getattr(component, own), spec)
            (constants if line.startswith("const") else parameters).append(line)
        arguments = ", ".join(f"{own}_{number}" for own in component.parameter_specs)
        calls.append(f"{name}(p, {arguments})")
    functions = [glsl(name) for name in (COMMON, *dict.fromkeys(names))]
    shader = [*functions, *constants, FUNCTION.format(sum=" + ".join(calls))]
    return "\n".join(["analytic", *_section("parameters", parameters), *_section("shader", shader)]) + "\n"


def _section(name: str, lines: Sequence[str]) -> list[str]:
    return ["", f"::begin {name}", *lines, f"::end {name}"]


def _declared(name: str, value: Tensor, spec: BoundedParameter) -> str:
    """A parameter with a slider or a colour; a constant, if it is neither."""
    own = numbers(value)
    text = [f"{number:.9g}" for number in own]
    if spec.size == 1:
        return f"float {name} {min(spec.lower, *own):.9g} {max(spec.upper, *own):.9g} {text[0]}"
    if all(0 <= number <= 1 for number in own):
        return f"color {name} {' '.join(text)}"
    return f"const vec3 {name} = vec3({', '.join(text)});"
