"""What a lobe is: a function of Pairs with bounded parameters, and its module form."""

import copy
import math
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, ClassVar, Self, overload

import torch
from torch import Tensor, nn
from torch.autograd import forward_ad

from torchbrdf.errors import ShapeError
from torchbrdf.pairs import Pairs
from torchbrdf.registry import Registry

LOBES: Registry[type["Lobe"]] = Registry("lobe", "torchbrdf.lobes")

# torch's forward differentiation has one level for all threads.
_FORWARD = threading.Lock()


@dataclass
class BoundedParameter:
    """A parameter of a lobe, declared once: where a fit starts, its bounds, and what it means.

    `shape` is (3,) for a colour, (1,) for a scalar. `linear` says that the lobe's value is proportional to it
    (an albedo), `affine` that it is a constant plus something proportional to it (Schlick's F0); what is neither is
    a shape. `log` asks solvers to move it on a logarithmic scale, for a range of many decades.
    """

    start: float
    lower: float
    upper: float
    doc: str
    shape: tuple[int, ...] = (1,)
    linear: bool = False
    affine: bool = False
    log: bool = False
    name: str = field(default="", init=False)

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name
        if not self.lower <= self.start <= self.upper or (self.log and self.lower <= 0):
            found = f"lower {self.lower:g}, start {self.start:g}, upper {self.upper:g}"
            above = "0 < " if self.log else ""
            raise ShapeError(f"{owner.__name__}.{name}: expected {above}lower <= start <= upper, found {found}")

    @overload
    def __get__(self, lobe: None, owner: type) -> "BoundedParameter": ...
    @overload
    def __get__(self, lobe: "Lobe", owner: type) -> Tensor: ...
    def __get__(self, lobe: "Lobe | None", owner: type) -> "BoundedParameter | Tensor":
        if lobe is None:
            return self
        try:
            return lobe._parameters[self.name]  # type: ignore[return-value]
        except KeyError:
            raise AttributeError(f"{owner.__name__} has no {self.name} yet") from None

    @property
    def size(self) -> int:
        """How many numbers a material has."""
        return math.prod(self.shape)


def albedo(shape: tuple[int, ...] = (3,), *, start: float, upper: float = 1.0, doc: str) -> BoundedParameter:
    """An albedo: linear, from 0 to 1, one value a channel."""
    return BoundedParameter(start=start, lower=0.0, upper=upper, doc=doc, shape=shape, linear=True)


class Lobe(nn.Module):
    """A BRDF or a part of one: `lobe(pairs)` gives values in 1/sr, `(..., N, 3)`, without the cosine.

    A subclass declares its parameters as `BoundedParameter` class attributes and names its functional form:

        @LOBES.register("ward")
        class Ward(Lobe):
            specular = albedo(start=0.5, doc="...")
            roughness = BoundedParameter(start=0.01, lower=0.001, upper=0.5, doc="...")
            function = staticmethod(ward)

    Parameters have the shape `(k,)`, or `(M, k)` after `batched(M)`. A value at construction may be a number, for
    every channel, or anything that broadcasts to the declared shape behind leading dimensions.
    """

    parameter_specs: ClassVar[dict[str, BoundedParameter]] = {}
    function: ClassVar[Callable[..., Tensor]]

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        own = {name: value for name, value in vars(cls).items() if isinstance(value, BoundedParameter)}
        cls.parameter_specs = {**cls.parameter_specs, **own}

    def __init__(self, *, dtype: torch.dtype | None = None, **values: Tensor | float | list[float]) -> None:
        super().__init__()
        extra = sorted(set(values) - set(self.parameter_specs))
        if extra:
            known = ", ".join(self.parameter_specs)
            raise ShapeError(f"{type(self).__name__}: unknown parameter {extra[0]!r}; expected {known}")
        for name, bounded in self.parameter_specs.items():
            value = torch.as_tensor(values.get(name, bounded.start))
            value = value.to(dtype or (value.dtype if value.is_floating_point() else torch.get_default_dtype()))
            try:
                lead = value.shape[: max(value.dim() - len(bounded.shape), 0)]
                value = value.expand(*lead, *bounded.shape)
            except RuntimeError:
                where = f"{type(self).__name__}.{name}"
                raise ShapeError(
                    f"{where}: expected (..., {', '.join(map(str, bounded.shape))}), found {(*value.shape,)}"
                ) from None
            self.register_parameter(name, nn.Parameter(value.clone()))

    def forward(self, pairs: Pairs) -> Tensor:
        """Values on pairs, `(..., N, 3)`."""
        return type(self).function(pairs, *(getattr(self, name) for name in self.parameter_specs))

    @classmethod
    def albedo_spec(cls) -> "BoundedParameter | None":
        """The linear colour of a lobe that is one colour times a scalar function of pairs and scalars, else None."""
        colors = [bounded for bounded in cls.parameter_specs.values() if bounded.linear and bounded.shape == (3,)]
        rest = [bounded for bounded in cls.parameter_specs.values() if bounded not in colors]
        return colors[0] if len(colors) == 1 and all(bounded.size == 1 for bounded in rest) else None

    @classmethod
    def scalars(cls) -> list["BoundedParameter"]:
        """The other parameters of such a lobe."""
        return [bounded for bounded in cls.parameter_specs.values() if bounded is not cls.albedo_spec()]

    @classmethod
    def unit_response(cls, pairs: Pairs, *scalars: Tensor) -> Tensor:
        """The scalar function of such a lobe, its values where its colour is 1, `(..., N)`."""
        color = cls.albedo_spec()
        if color is None:
            raise ShapeError(f"{cls.__name__} is no colour times a scalar function")
        one = torch.ones_like(scalars[0]) if scalars else pairs.cos_i.new_ones(1)
        named = dict(zip((bounded.name for bounded in cls.scalars()), scalars, strict=True))
        return cls.function(pairs, **{color.name: one}, **named)[..., 0]

    @classmethod
    def value_and_jacobian(cls, pairs: Pairs, *scalars: Tensor) -> list[Tensor]:
        """`unit_response`, and its derivative by each of `scalars`, `(..., N)` all.

        Where both directions are above the horizon. By forward differentiation, unless a lobe knows a shorter way.
        """
        found: list[Tensor] = []
        for k, moved in enumerate(scalars):
            with _FORWARD, forward_ad.dual_level():
                dual = forward_ad.make_dual(moved, torch.ones_like(moved))
                own = [dual if i == k else other for i, other in enumerate(scalars)]
                value, tangent = forward_ad.unpack_dual(cls.unit_response(pairs, *own))
            found = found or [value]
            found.append(torch.zeros_like(value) if tangent is None else tangent)
        return found or [cls.unit_response(pairs)]

    def components(self) -> list["Lobe"]:
        """The lobes that this one adds up; itself, if it is no sum."""
        return [self]

    def batched(self, materials: int) -> Self:
        """A copy with its own parameters for each of M materials, `(M, k)`."""
        made = copy.deepcopy(self)
        for part in made.components():
            for name, bounded in part.parameter_specs.items():
                value = getattr(part, name).detach()
                if value.dim() > len(bounded.shape) and value.shape[0] not in (1, materials):
                    raise ShapeError(f"{type(part).__name__}.{name}: {value.shape[0]} materials, not {materials}")
                value = value.expand(materials, *bounded.shape).clone()
                setattr(part, name, nn.Parameter(value))
        return made

    def named_specs(self) -> list[tuple["Lobe", BoundedParameter]]:
        """Every parameter of every part, in the order of `pack`."""
        return [(part, bounded) for part in self.components() for bounded in part.parameter_specs.values()]

    def pack(self) -> Tensor:
        """All parameters beside each other, `(M, P)`, detached; `(P,)` if not batched."""
        values = [
            getattr(part, bounded.name).detach().flatten(start_dim=-len(bounded.shape))
            for part, bounded in self.named_specs()
        ]
        return torch.cat(values, -1)

    def unpack(self, packed: Tensor) -> Self:
        """A copy with the parameters of `packed`, as `pack` orders them, `(..., P)`."""
        sizes = [bounded.size for _, bounded in self.named_specs()]
        if packed.shape[-1:] != (sum(sizes),):
            raise ShapeError(f"unpack: expected (..., {sum(sizes)}), found {(*packed.shape,)}")
        made = copy.deepcopy(self)
        for (part, bounded), value in zip(made.named_specs(), packed.detach().split(sizes, -1), strict=True):
            setattr(part, bounded.name, nn.Parameter(value.reshape(*value.shape[:-1], *bounded.shape).clone()))
        return made

    @property
    def bounds(self) -> tuple[Tensor, Tensor]:
        """Lower and upper bounds, `(P,)` each, in the order of `pack`."""
        lower = [torch.full((bounded.size,), bounded.lower) for _, bounded in self.named_specs()]
        upper = [torch.full((bounded.size,), bounded.upper) for _, bounded in self.named_specs()]
        like = self.pack()
        return torch.cat(lower).to(like), torch.cat(upper).to(like)
