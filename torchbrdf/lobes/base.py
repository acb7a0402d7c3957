"""What a lobe is: a function of Pairs with bounded parameters, and its module form."""

import copy
import inspect
from collections.abc import Mapping
from dataclasses import InitVar
from typing import TYPE_CHECKING, Any, ClassVar, Self, dataclass_transform

import torch
from torch import Tensor, nn

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.kinds import LOBES as _LOBES
from torchbrdf.lobes.evaluation import check_leading, check_signature, check_values, half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, Value
from torchbrdf.lobes.separable import value_of
from torchbrdf.lobes.terms import Separable
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

LOBES: Registry[type["Lobe"]] = _LOBES
RGB = 3
"""Channels of linear RGB."""


@dataclass_transform(kw_only_default=True, eq_default=False)
class _Declared(nn.Module):
    """A module whose class attributes are the arguments of its constructor, which type checkers and editors see so."""


class Lobe(_Declared, Separable):
    """A BRDF or a part of one: `lobe(pairs)` gives values in 1/sr, without the cosine.

    A subclass declares its parameters as `BoundedParameter` class attributes, which are also the arguments of its
    constructor, and names its functional form:

        @LOBES.register("ward")
        class Ward(Lobe):
            specular: BoundedParameter = albedo(start=0.5, doc="...")
            roughness: BoundedParameter = BoundedParameter(start=0.01, lower=0.001, upper=0.5, doc="...")
            function = staticmethod(ward)

    Parameters have the shape `(k,)`, or `(M, k)` after `batched(M)`. They can be set to what the constructor takes:
    `lobe.roughness = 0.3`. Of numbers they are on the CPU, whatever torch's default device is, and of tensors where
    these are; `to` moves them. Half precision is worked out in float32, see `half_in_float32`.

    Args:
        dtype: of the parameters; by default the values' own, or torch's.
        values: for each declared parameter a number for every channel, or what broadcasts to its shape behind leading
            dimensions; its start if it is not given.

    Raises:
        UsageError: a parameter is not declared.
        UsageError: the function's parameters are not those that are declared.
        ShapeError: a value does not broadcast to the declared shape, or is not finite; the values' leading dimensions
            do not broadcast.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> from torchbrdf.lobes import Ward
        >>> lobe = Ward(specular=[0.3, 0.2, 0.1], roughness=0.1)
        >>> lobe
        Ward(specular=[0.3, 0.2, 0.1], roughness=0.1)
        >>> up = torch.tensor([[0.0, 0.0, 1.0]])
        >>> lobe(Pairs.from_directions(up, up)).shape
        torch.Size([1, 3])
    """

    is_diffuse: ClassVar[bool] = False
    """Whether it is a diffuse term, of which a model has at most one."""
    default_diffuse: ClassVar[str | None] = None
    """How `torchbrdf.fit` treats the diffuse albedo of a model with this lobe unless told; None: as the loss has it."""
    is_material: ClassVar[bool] = False
    """Whether it is a whole BRDF by itself, such as a renderer's material: a model of its own, with no other lobe."""
    channels: ClassVar[int] = RGB
    """How many channels values have: those of linear RGB, or bands, see `torchbrdf.lobes.in_bands`."""
    in_rgb: ClassVar[type["Lobe"]]
    """The kind with three channels; itself, if it has these."""
    is_anisotropic: ClassVar[bool] = False
    """Whether values change as the surface is turned about its normal; such a lobe needs pairs that know directions."""
    __signature__: ClassVar[inspect.Signature]
    if TYPE_CHECKING:
        dtype: InitVar[torch.dtype | None] = None

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, BoundedParameter)}
        cls.parameter_specs = {**cls.parameter_specs, **own}
        if "in_rgb" not in vars(cls):
            cls.in_rgb = cls
        if cls.has_terms() and not hasattr(cls, "function"):
            cls.function = staticmethod(value_of(cls))
        cls.__signature__ = _signature(cls)

    def __init__(self, *, dtype: torch.dtype | None = None, **values: Value) -> None:
        super().__init__()
        for name in sorted(set(values) - set(self.parameter_specs)):
            known = ", ".join(self.parameter_specs)
            raise UsageError(f"{type(self).__name__}: unknown parameter {name!r}; expected {known}")
        for name, spec in self.parameter_specs.items():
            value = spec.expand(values.get(name, spec.start), f"{type(self).__name__}.{name}", dtype)
            self.register_parameter(name, nn.Parameter(value.clone()))
        self._check()

    def __setattr__(self, name: str, value: Any) -> None:
        """Plain values of parameters become parameters, which modules of torch refuse."""
        spec = self.parameter_specs.get(name)
        if spec is None or isinstance(value, nn.Parameter):
            super().__setattr__(name, value)
        else:
            spec.__set__(self, value)

    def extra_repr(self) -> str:
        """The parameters: their values, or the shape of many."""
        return ", ".join(f"{name}={_shown(getattr(self, name), spec)}" for name, spec in self.parameter_specs.items())

    def forward(self, pairs: Pairs) -> Tensor:
        """Values on pairs, `(..., N, C)`, of which C is 3 but for bands.

        Raises:
            ShapeError: the leading dimensions of parameters and pairs do not broadcast, or the function gives no values
                of this shape.
        """
        kind = type(self)
        try:
            found = half_in_float32(kind.function)(pairs, *(getattr(self, name) for name in self.parameter_specs))
        except RuntimeError:
            check_leading(kind.__name__, {**self._leading(), "pairs": (*pairs.shape[:-1],)})
            raise
        check_values(kind.__name__, found, pairs, kind.channels)
        return found

    def _leading(self) -> dict[str, tuple[int, ...]]:
        """The leading dimensions of each parameter."""
        specs = self.parameter_specs
        return {name: (*getattr(self, name).shape[: -len(spec.shape) or None],) for name, spec in specs.items()}

    def _check(self) -> None:
        """Refuse parameters that do not go together, and a function that does not take them."""
        kind = type(self)
        if kind.forward is Lobe.forward and self.parameter_specs:
            if not hasattr(kind, "function"):
                expected = ", ".join(["pairs", *self.parameter_specs])
                raise UsageError(f"{kind.__name__}: expected a function of ({expected}), found none")
            check_signature(kind.__name__, kind.function, list(self.parameter_specs))
        check_leading(kind.__name__, self._leading())

    @classmethod
    def canonical(cls, parameters: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Of all parameters that give the same lobe those that fits tell.

        Args:
            parameters: all of the lobe's by name, `(..., k)`.

        Returns:
            The same, or others of the same lobe.

        Example:
            >>> import torch
            >>> from torchbrdf.lobes import WardAnisotropic
            >>> WardAnisotropic.canonical(dict(WardAnisotropic(roughness_x=0.3, roughness_y=0.1).named_parameters()))[
            ...     "roughness_x"
            ... ].item()
            0.10000000149011612
        """
        return dict(parameters)

    @classmethod
    def other_starts(cls, parameters: Mapping[str, Tensor]) -> list[dict[str, Tensor]]:
        """Where the staged procedure starts as well, of which it goes on with the best.

        Args:
            parameters: where it starts first, all of the lobe's by name, `(..., k)`.

        Returns:
            Parameters in their place.

        Example:
            >>> from torchbrdf.lobes import Ward, WardAnisotropic
            >>> [len(kind.other_starts(dict(kind().named_parameters()))) for kind in (Ward, WardAnisotropic)]
            [0, 3]
        """
        return []

    def components(self) -> list["Lobe"]:
        """The lobes that this one adds up; itself, if it is no sum."""
        return [self]

    def batched(self, materials: int) -> Self:
        """A copy with parameters of its own for each of M materials.

        Args:
            materials: M.

        Returns:
            The copy, whose parameters are `(M, *shape)`.

        Raises:
            ShapeError: it is batched already, for another number of materials.

        Example:
            >>> from torchbrdf.lobes import Ward
            >>> Ward().batched(4)
            Ward(specular=<4 x 3>, roughness=<4 x 1>)
        """
        made = copy.deepcopy(self)
        for component in made.components():
            for name, spec in component.parameter_specs.items():
                value = getattr(component, name).detach()
                if value.dim() > len(spec.shape) and value.shape[0] not in (1, materials):
                    raise ShapeError(f"{type(component).__name__}.{name}: {value.shape[0]} materials, not {materials}")
                value = value.expand(materials, *spec.shape).clone()
                setattr(component, name, nn.Parameter(value))
        return made


def _signature(lobe: type[Lobe]) -> inspect.Signature:
    """The arguments of a lobe's constructor, as `help` and editors that run the code show them."""
    if lobe.__init__ is not Lobe.__init__:
        return inspect.Signature(list(inspect.signature(lobe.__init__).parameters.values())[1:])
    own = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=spec.start, annotation=Value)
        for name, spec in lobe.parameter_specs.items()
    ]
    kind = torch.dtype | None
    return inspect.Signature(
        [*own, inspect.Parameter("dtype", inspect.Parameter.KEYWORD_ONLY, default=None, annotation=kind)]
    )


def _shown(value: Tensor, spec: BoundedParameter) -> str:
    """Values with four digits, or a shape, as <4 x 3>."""
    if value.shape != spec.shape or spec.size > 3:
        return f"<{' x '.join(map(str, value.shape))}>"
    shown = [f"{one:.4g}" for one in value.flatten().tolist()]
    return shown[0] if spec.size == 1 else f"[{', '.join(shown)}]"
