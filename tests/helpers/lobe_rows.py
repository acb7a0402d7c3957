"""The rows of docs/lobes.md, as far as the registries know them."""

from torchbrdf.lobes import LOBES, ROUGHNESS, BoundedParameter


def cells(name: str) -> list[str]:
    """The first cells of a lobe's row: its name, its kind, its parameters with their bounds, and how it is fitted."""
    kind = LOBES[name]
    what = "whole material" if kind.is_material else "diffuse term" if kind.is_diffuse else "lobe"
    declared = ", ".join(_declared(spec) for spec in kind.parameter_specs.values())
    return [f"`{name}`", what, declared, "fast" if kind.is_separable() else "by graph"]


def _declared(spec: BoundedParameter) -> str:
    many = f" x {' x '.join(map(str, spec.shape))}" if spec.size > 1 else ""
    return f"`{spec.name}` {spec.lower:g} to {spec.upper:g}{' log' if spec.log else ''}{many}"


def convention_cells(name: str) -> list[str]:
    """A convention's row: its name, what it is, and alpha of it."""
    convention = ROUGHNESS[name]
    return [f"`{name}`", convention.meaning, convention.formula]
