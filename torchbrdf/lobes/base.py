"""What a lobe is: a function of Pairs with bounded parameters, and its module form."""

import copy
import inspect
from collections.abc import Callable, Mapping
from dataclasses import InitVar
from typing import TYPE_CHECKING, Any, ClassVar, Self, dataclass_transform

import torch
from torch import Tensor, nn

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.kinds import LOBES as _LOBES
from torchbrdf.lobes.evaluation import check_leading, check_signature, check_values, half_in_float32
from torchbrdf.lobes.parameter import BoundedParameter, Value
from torchbrdf.lobes.separable import Slopes, tangents, value_of
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

LOBES: Registry[type["Lobe"]] = _LOBES
RGB = 3
"""Channels of linear RGB."""


@dataclass_transform(kw_only_default=True, eq_default=False)
class _Declared(nn.Module):
    """A module whose class attributes are the arguments of its constructor, which type checkers and editors see so."""


class Lobe(_Declared):
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

    parameter_specs: ClassVar[dict[str, BoundedParameter]] = {}
    """The declared parameters by name, those of base classes first."""
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
    scalars_of_terms: ClassVar[tuple[str, ...] | None] = None
    """The parameters that `terms` takes, in that order; None: all of one number."""
    function: ClassVar[Callable[..., Tensor]]
    """The functional form: `function(pairs, *parameters)`, `(..., N, 3)`."""
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
    def albedo_spec(cls) -> "BoundedParameter | None":
        """The declaration of the albedo of a lobe that is one albedo times a scalar function of pairs and scalars.

        Returns:
            The only linear parameter with one value a channel where all others are scalars; None of any other lobe, and
            of one that declares `terms`.

        Example:
            >>> from torchbrdf.lobes import LowABC, ShiftedGamma
            >>> LowABC.albedo_spec().name, ShiftedGamma.albedo_spec()
            ('amplitude', None)
        """
        if cls.has_terms():
            return None
        albedos = [spec for spec in cls.parameter_specs.values() if spec.linear and spec.is_colour]
        rest = [spec for spec in cls.parameter_specs.values() if spec not in albedos]
        return albedos[0] if len(albedos) == 1 and all(spec.is_scalar for spec in rest) else None

    @classmethod
    def scalars(cls) -> list["BoundedParameter"]:
        """The declarations of a lobe's parameters other than the albedo.

        Example:
            >>> from torchbrdf.lobes import Ward
            >>> [spec.name for spec in Ward.scalars()]
            ['roughness']
        """
        return [spec for spec in cls.parameter_specs.values() if spec is not cls.albedo_spec()]

    @classmethod
    def unit_response(cls, pairs: Pairs, *scalars: Tensor) -> Tensor:
        """Values of a lobe where its albedo is 1.

        Args:
            pairs: where values are wanted, `(..., N)`.
            scalars: the other parameters, `(..., 1)` each, in the order of `scalars()`.

        Returns:
            Values in 1/sr, `(..., N)`.

        Raises:
            UsageError: the lobe is no albedo times a scalar function.

        Example:
            >>> import math, torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.lobes import Lambert
            >>> up = torch.tensor([[0.0, 0.0, 1.0]])
            >>> Lambert.unit_response(Pairs.from_directions(up, up)) * math.pi
            tensor([1.])
        """
        colour = cls.albedo_spec()
        if colour is None:
            raise UsageError(f"{cls.__name__}: expected an albedo times a scalar function, found a lobe that is none")
        one = torch.ones_like(scalars[0]) if scalars else pairs.cos_i.new_ones(1)
        named = dict(zip((spec.name for spec in cls.scalars()), scalars, strict=True))
        return cls.function(pairs, **{colour.name: one}, **named)[..., 0]

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """Values of a lobe where its albedo is 1, and their derivatives by each of its scalars.

        By forward differentiation, unless a lobe knows a shorter way.

        Args:
            pairs: where values are wanted, `(..., N)`; below the horizon the result means nothing.
            scalars: the other parameters, `(..., 1)` each, in the order of `scalars()`.

        Returns:
            `unit_response` and one derivative for each scalar, `(..., N)` all.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.lobes import Ward
            >>> angle = torch.full((2, 5), 0.1)
            >>> columns = Ward.value_and_jacobian(Pairs.from_half_diff(angle, angle, angle), torch.tensor([0.2]))
            >>> [column.shape for column in columns]
            [torch.Size([2, 5]), torch.Size([2, 5])]
        """
        (value,), slopes = tangents(lambda *own: [cls.unit_response(pairs, *own)], scalars)
        return [value, *(torch.zeros_like(value) if slope is None else slope for (slope,) in slopes)]

    @classmethod
    def has_terms(cls) -> bool:
        """Whether the lobe declares `terms` and `coefficients` of its own."""
        return cls.terms.__func__ is not Lobe.terms.__func__  # type: ignore[attr-defined]

    @classmethod
    def is_separable(cls) -> bool:
        """Whether its values are coefficients times terms, so that fits need no graph.

        Example:
            >>> from torchbrdf.lobes import EON, DistributionBased, Ward
            >>> Ward.is_separable(), EON.is_separable(), DistributionBased.is_separable()
            (True, True, False)
        """
        return cls.has_terms() or cls.albedo_spec() is not None

    @classmethod
    def term_scalars(cls) -> list["BoundedParameter"]:
        """The declarations of the parameters that `terms` takes."""
        if not cls.has_terms():
            return cls.scalars()
        if cls.scalars_of_terms is None:
            return [spec for spec in cls.parameter_specs.values() if spec.is_scalar]
        return [cls.parameter_specs[name] for name in cls.scalars_of_terms]

    @classmethod
    def terms(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """The scalar functions s_j of a lobe whose values are sum_j A_cj s_j, for channel c.

        A lobe that is no albedo times one function declares `terms` and `coefficients`; its `function` follows.

        Args:
            pairs: where values are wanted, `(..., N)`.
            scalars: the parameters `(..., 1)` of `term_scalars()`. A parameter with a number a channel, `(..., 3)`, is
                one of a lobe with three terms, of which term j takes the j-th number alone.

        Returns:
            J tensors in 1/sr, `(..., N)` or what broadcasts to it; below the horizon they mean nothing.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.lobes import EON
            >>> angle = torch.full((2, 5), 0.1)
            >>> [term.shape for term in EON.terms(Pairs.from_half_diff(angle, angle, angle), torch.tensor([0.2]))]
            [torch.Size([2, 5]), torch.Size([2, 5])]
        """
        return [cls.unit_response(pairs, *scalars)]

    @classmethod
    def terms_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> tuple[list[Tensor], Slopes]:
        """The terms, and their derivatives by each of the scalars.

        By forward differentiation, unless a lobe knows a shorter way.

        Args:
            pairs: where values are wanted, `(..., N)`; below the horizon the result means nothing.
            scalars: the parameters `(..., 1)` of `term_scalars()`.

        Returns:
            `terms`; and a list for each scalar with one derivative a term, None where the term never depends on it.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.lobes import EON
            >>> angle = torch.full((2, 5), 0.1)
            >>> terms, slopes = EON.terms_and_jacobian(Pairs.from_half_diff(angle, angle, angle), torch.tensor([0.2]))
            >>> len(terms), [len(own) for own in slopes]
            (2, [2])
        """
        if not cls.has_terms():
            value, *slopes = cls.value_and_jacobian(pairs, *scalars)
            return [value], [[slope] for slope in slopes]
        return tangents(lambda *own: cls.terms(pairs, *own), scalars)

    @classmethod
    def has_pair_factors(cls) -> bool:
        """Whether the lobe has `pair_factors`: it declares some, or no scalar enters its terms.

        Example:
            >>> from torchbrdf.lobes import GGX, Lambert, Ward
            >>> Ward.has_pair_factors(), Lambert.has_pair_factors(), GGX.has_pair_factors()
            (True, True, False)
        """
        declared = cls.pair_factors.__func__ is not Lobe.pair_factors.__func__  # type: ignore[attr-defined]
        return declared or (cls.is_separable() and not cls.term_scalars())

    @classmethod
    def pair_factors(cls, pairs: Pairs) -> list[Tensor]:
        """Functions B_j of a pair, of which all terms are sum_j H_j(theta_h; scalars) B_j(pair).

        No parameter enters them. A lobe whose shape depends on the half angle alone, but for its shadowing and
        Fresnel's weight, declares them: fits under losses of squares then need no pass over the pairs of a table.

        Args:
            pairs: where they are wanted, `(..., N)`.

        Returns:
            J tensors, `(..., N)` or what broadcasts to it; below the horizon they mean nothing.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> from torchbrdf.lobes import CookTorrance
            >>> angle = torch.full((1, 5), 0.1)
            >>> len(CookTorrance.pair_factors(Pairs.from_half_diff(angle, angle, angle)))
            2
        """
        return cls.terms(pairs)

    @classmethod
    def coefficients(cls, **parameters: Tensor) -> Tensor:
        """The factors A_cj of the terms, by operations that torch differentiates.

        Args:
            parameters: all of the lobe's by name, `(..., k)`; leading dimensions broadcast.

        Returns:
            `(..., C, J)`; C is 1 where all channels have the same.

        Raises:
            UsageError: the lobe is no coefficients times terms.

        Example:
            >>> import torch
            >>> from torchbrdf.lobes import EON
            >>> EON.coefficients(albedo=torch.rand(4, 3), roughness=torch.rand(4, 1)).shape
            torch.Size([4, 3, 2])
        """
        colour = cls.albedo_spec()
        if colour is None:
            raise UsageError(f"{cls.__name__}: expected coefficients times terms, found a lobe that declares none")
        return parameters[colour.name][..., None]

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
