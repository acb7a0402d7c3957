"""Pairs of incident and outgoing directions, with the cosines that BRDFs need, computed once."""

from collections.abc import Callable, ItemsView, Sequence
from functools import reduce
from types import ModuleType

import numpy as np
import torch
from torch import Tensor

from torchbrdf.errors import ShapeError, UsageError
from torchbrdf.precision import HALVES
from torchbrdf.quantities import (
    ORIENTED,
    QUANTITIES,
    check_max_theta,
    derived,
    is_oriented,
    of_directions,
    of_half_diff,
)

__all__ = ["QUANTITIES", "Pairs", "check_max_theta", "take"]

Index = Tensor | slice | list[int] | None
Owner = Callable[..., object] | type | ModuleType


class Pairs:
    """N pairs of unit directions, `wi` to the light and `wo` to the viewer, for M materials or shared by all.

    Both directions point away from the surface; the normal is +z and the tangent +x. Every quantity has the shape
    `(..., N)` (`wi` and `wo`: `(..., N, 3)`), usually `(M, N)`, or `(1, N)` where all materials share the pairs.
    Angles are in radians: Rusinkiewicz' half and difference angles, theta_h and theta_d in [0, pi/2], phi_d in
    [0, pi), phi_h in (-pi, pi]. Quantities that were not given are derived at first use and kept. dtype and device are
    the inputs'; what is derived of half precision is computed in float32.

    Gradients by directions, angles and cosines are finite wherever the quantities are: 0 where there is none, or an
    infinite one, as at the tip of the cone theta_h over directions, h = n, or for opposite directions.

    tan2_h, the squared tangent of theta_h, is kept because sharp lobes live where a float32 cos_h is 1, and slope_x and
    slope_y, the half vector's x and y over its z, for those that are anisotropic.

    `from_directions`, `from_half_diff` and `from_cosines` make one; the constructor takes `QUANTITIES` as they are.

    Args:
        known: quantities by name, of shapes and dtypes that fit together; they are not checked. Directions that lie to
            the tangent as they say come first: behind the half vector's angles they only follow from these.

    Raises:
        UsageError: a name is not one of `QUANTITIES`.

    Source: S. Rusinkiewicz, A New Change of Variables for Efficient BRDF Representation, 1998,
    doi:10.1007/978-3-7091-6453-2_2.

    Example:
        >>> import torch
        >>> from torchbrdf import Pairs
        >>> wi = torch.tensor([[0.6, 0.0, 0.8], [0.0, 0.0, 1.0]])
        >>> pairs = Pairs.from_directions(wi, wo=torch.tensor([[-0.6, 0.0, 0.8]]))
        >>> len(pairs), pairs.cos_h
        (2, tensor([1.0000, 0.9487]))
    """

    def __init__(self, **known: Tensor) -> None:
        for name in known:
            if name not in QUANTITIES:
                raise UsageError(f"Pairs: unknown quantity {name!r}; expected {', '.join(QUANTITIES)}")
        self._known = known
        self._cached: dict[tuple[Owner, str], Tensor] = {}

    @classmethod
    def from_directions(cls, wi: Tensor, wo: Tensor) -> "Pairs":
        """Make pairs of unit vectors.

        Args:
            wi: directions to the light, `(..., N, 3)`.
            wo: directions to the viewer, `(..., N, 3)`; the two broadcast against each other.

        Returns:
            Pairs `(..., N)`, of which every quantity is known or can be derived.

        Raises:
            ShapeError: a last dimension is not 3.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> up = torch.tensor([[0.0, 0.0, 1.0]])
            >>> Pairs.from_directions(up, up).theta_d
            tensor([0.])
        """
        if wi.shape[-1:] != (3,) or wo.shape[-1:] != (3,):
            raise ShapeError(f"Pairs: expected directions (..., N, 3), found wi {(*wi.shape,)} and wo {(*wo.shape,)}")
        wi, wo = torch.broadcast_tensors(wi, wo)
        dtype = torch.promote_types(wi.dtype, wo.dtype)
        if dtype in HALVES:
            return cls.from_directions(wi.float(), wo.float()).to(dtype=dtype)
        return cls(**of_directions(wi.to(dtype), wo.to(dtype)))

    @classmethod
    def from_half_diff(cls, theta_h: Tensor, theta_d: Tensor, phi_d: Tensor, phi_h: Tensor | None = None) -> "Pairs":
        """Make pairs from Rusinkiewicz' half and difference angles.

        Args:
            theta_h: angle between the normal and the half vector, radians, `(..., N)`.
            theta_d: angle between the half vector and either direction, radians, `(..., N)`.
            phi_d: azimuth of the light about the half vector, radians, `(..., N)`.
            phi_h: azimuth of the half vector about the normal, radians, `(..., N)`, which anisotropic lobes need; all
                that is given broadcasts.

        Returns:
            Pairs `(..., N)`. Without phi_h their half vectors lie in the plane of x and z, and what depends on that is
            a ShapeError when it is asked for.

        Example:
            >>> import math, torch
            >>> from torchbrdf import Pairs
            >>> angle = torch.tensor([math.pi / 8])
            >>> reading = Pairs.from_half_diff(angle, angle, torch.zeros(1))  # light at 45 degrees, viewer at 0
            >>> reading.cos_i, reading.cos_o
            (tensor([0.7071]), tensor([1.]))
        """
        given = [theta_h, theta_d, phi_d] if phi_h is None else [theta_h, theta_d, phi_d, phi_h]
        given = list(torch.broadcast_tensors(*given))
        dtype = reduce(torch.promote_types, (angle.dtype for angle in given))
        if dtype in HALVES:
            return cls.from_half_diff(*(angle.float() for angle in given)).to(dtype=dtype)
        return cls(**of_half_diff(*(angle.to(dtype) for angle in given)))

    @classmethod
    def from_cosines(
        cls,
        cos_i: Tensor,
        cos_o: Tensor | None = None,
        cos_h: Tensor | None = None,
        cos_d: Tensor | None = None,
        tan2_h: Tensor | None = None,
    ) -> "Pairs":
        """Make pairs from the cosines that a renderer already has.

        Args:
            cos_i: cosine between normal and light, `(..., N)`.
            cos_o: cosine between normal and viewer, `(..., N)`.
            cos_h: cosine between normal and half vector, `(..., N)`.
            cos_d: cosine between half vector and either direction, `(..., N)`.
            tan2_h: squared tangent of the angle between normal and half vector, `(..., N)`; better than cos_h where
                lobes are sharp.

        Returns:
            Pairs `(..., N)`. A quantity that cannot be derived is a ShapeError when it is asked for.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> Pairs.from_cosines(torch.tensor([0.5, -0.5]), torch.tensor([1.0, 1.0])).above_horizon
            tensor([ True, False])
        """
        given = {"cos_i": cos_i, "cos_o": cos_o, "cos_h": cos_h, "cos_d": cos_d, "tan2_h": tan2_h}
        return cls(**{name: value for name, value in given.items() if value is not None})

    def _get(self, name: str) -> Tensor:
        value = self._known.get(name)
        if value is None:
            wide = self.widened()
            value = derived(name, self._known, self._get) if wide is self else wide._get(name)
            if wide is not self and value.dtype != torch.bool:
                value = value.to(self.dtype)
            self._known[name] = value
        return value

    def cached(self, owner: Owner, make: Callable[[], Tensor], name: str = "") -> Tensor:
        """A quantity of somebody else's that depends on the pairs alone: made at first use, and kept.

        What is kept follows `select`, `to` and `unsqueeze`. Two packages cannot get each other's: a quantity belongs to
        the function, class or module that asks for it.

        Args:
            owner: the module-level function or class, or the module, that the quantity belongs to.
            make: makes it, `(..., N)`; called only where it is not there yet. A result with a graph is not kept.
            name: tells several quantities of one owner apart.

        Returns:
            The quantity, `(..., N)`.

        Raises:
            UsageError: the owner is a local function or a lambda, of which each call makes another one.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> def grazing(pairs: Pairs) -> torch.Tensor:
            ...     return pairs.cached(grazing, lambda: 1 - pairs.cos_i)
            >>> pairs = Pairs.from_cosines(torch.tensor([0.25]))
            >>> grazing(pairs) is grazing(pairs)
            True
        """
        # Compilers do not know the names of functions, and have seen this when it ran.
        if not torch.compiler.is_compiling() and "<" in getattr(owner, "__qualname__", ""):
            raise UsageError(f"Pairs.cached: expected an owner at the top of a module, found {owner.__qualname__}")
        value = self._cached.get((owner, name))
        if value is None:
            value = make()
            if not value.requires_grad:
                self._cached[owner, name] = value
        return value

    def __getstate__(self) -> dict[str, object]:
        """What is cached is made again by whoever owns it."""
        return {"_known": self._known, "_cached": {}}

    @property
    def cos_i(self) -> Tensor:
        """Cosine of the angle between the normal and the light."""
        return self._get("cos_i")

    @property
    def cos_o(self) -> Tensor:
        """Cosine of the angle between the normal and the viewer."""
        return self._get("cos_o")

    @property
    def cos_h(self) -> Tensor:
        """Cosine of the angle between the normal and the half vector."""
        return self._get("cos_h")

    @property
    def cos_d(self) -> Tensor:
        """Cosine of the angle between the half vector and either direction."""
        return self._get("cos_d")

    @property
    def tan2_h(self) -> Tensor:
        """Squared tangent of theta_h."""
        return self._get("tan2_h")

    @property
    def theta_h(self) -> Tensor:
        """Angle between the normal and the half vector."""
        return self._get("theta_h")

    @property
    def theta_d(self) -> Tensor:
        """Angle between the half vector and either direction."""
        return self._get("theta_d")

    @property
    def phi_d(self) -> Tensor:
        """Azimuth of the light about the half vector, folded into [0, pi) by reciprocity."""
        return self._get("phi_d")

    @property
    def phi_h(self) -> Tensor:
        """Azimuth of the half vector about the normal, from the tangent on."""
        return self._get("phi_h")

    @property
    def slope_x(self) -> Tensor:
        """The half vector's x over its z, tan(theta_h) cos(phi_h)."""
        return self._get("slope_x")

    @property
    def slope_y(self) -> Tensor:
        """The half vector's y over its z, tan(theta_h) sin(phi_h)."""
        return self._get("slope_y")

    @property
    def is_oriented(self) -> bool:
        """Whether it is known how the pairs lie to the tangent, which anisotropic lobes need."""
        return is_oriented(self._known)

    @property
    def wi(self) -> Tensor:
        """Unit vectors to the light, `(..., N, 3)`."""
        return self._get("wi")

    @property
    def wo(self) -> Tensor:
        """Unit vectors to the viewer, `(..., N, 3)`."""
        return self._get("wo")

    @property
    def above_horizon(self) -> Tensor:
        """Whether both directions are above the horizon."""
        return self._get("above_horizon")

    @property
    def shape(self) -> torch.Size:
        """`(..., N)`."""
        return self._any().shape

    @property
    def dtype(self) -> torch.dtype:
        """dtype of every quantity."""
        return self._any().dtype

    @property
    def device(self) -> torch.device:
        """Device of every quantity."""
        return self._any().device

    def _any(self) -> Tensor:
        """A quantity `(..., N)` that is known: cos_i, if it is."""
        for name in ("cos_i", *self._known):
            if name in self._known:
                return self._known[name][..., 0] if name in ("wi", "wo") else self._known[name]
        return self.cos_i

    def __len__(self) -> int:
        return self.shape[-1]

    def __repr__(self) -> str:
        if not self._known:
            return "Pairs()"
        return f"Pairs({(*self.shape,)}, {self.dtype}, {self.device}, known: {', '.join(sorted(self._known))})"

    def items(self) -> ItemsView[str, Tensor]:
        """The quantities that are known so far, by name: `Pairs(**dict(pairs.items()))` is the same pairs.

        Returns:
            Names of `QUANTITIES` with their tensors, `(..., N)`, of `wi` and `wo` `(..., N, 3)`.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> dict(Pairs.from_cosines(torch.tensor([0.25])).items())
            {'cos_i': tensor([0.2500])}
        """
        return self._known.items()

    def _map(self, change: Callable[[Tensor, bool], Tensor]) -> "Pairs":
        """The same pairs with every tensor changed; `change` is told whether it has vectors, `(..., N, 3)`."""
        made = Pairs()
        made._known = {name: change(value, name in ("wi", "wo")) for name, value in self._known.items()}
        made._cached = {key: change(value, False) for key, value in self._cached.items()}
        return made

    def unsqueeze(self) -> "Pairs":
        """The same pairs with a dimension of 1 in front: `(N,)` becomes `(1, N)`, shared by all materials.

        Returns:
            Pairs `(1, ..., N)`, views of the same tensors.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> Pairs.from_cosines(torch.tensor([0.25, 0.5])).unsqueeze().shape
            torch.Size([1, 2])
        """
        return self._map(lambda value, _: value[None])

    def select(self, materials: Index = None, samples: Index = None) -> "Pairs":
        """The pairs of some materials and some samples.

        Args:
            materials: index into the first dimension; ignored where all materials share the pairs.
            samples: index into the last dimension. A slice gives views, a list or an index tensor copies.

        Returns:
            Pairs with what was known or kept of those.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> Pairs.from_cosines(torch.tensor([0.1, 0.2, 0.3])).select(samples=[2, 0]).cos_i
            tensor([0.3000, 0.1000])
        """

        def pick(value: Tensor, vector: bool) -> Tensor:
            sample_dim = value.dim() - (2 if vector else 1)
            if materials is not None and sample_dim > 0 and value.shape[0] > 1:
                value = take(value, materials, 0)
            return value if samples is None else take(value, samples, sample_dim)

        return self._map(pick)

    @classmethod
    def joined(cls, parts: Sequence["Pairs"], oriented: bool = False) -> "Pairs":
        """One after the other, by what isotropic BRDFs depend on: cosines and angles, without the directions.

        Args:
            parts: pairs `(n,)` or `(m, n)`, with m the same for all, or 1.
            oriented: with the directions and what else anisotropic BRDFs depend on.

        Returns:
            Pairs `(m, N)`, or `(N,)` where all parts are `(n,)`.

        Raises:
            ShapeError: a part does not know enough.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> one, other = (Pairs.from_half_diff(*torch.full((3, n), 0.1)) for n in (2, 3))
            >>> len(Pairs.joined([one, other]))
            5
        """
        lead = np.broadcast_shapes(*(part.shape[:-1] for part in parts))

        def whole(name: str) -> Tensor:
            vector = (3,) * (name in ("wi", "wo"))
            found = [part._get(name).expand(*lead, len(part), *vector) for part in parts]
            return torch.cat(found, len(lead))

        return cls(**{name: whole(name) for name in QUANTITIES if oriented or name not in ORIENTED})

    def widened(self) -> "Pairs":
        """The same pairs in float32, if they are in half precision; themselves, if they are not.

        What follows from directions or from half and difference angles that are known is derived from these anew.

        Returns:
            Pairs of float32 or float64.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> half = Pairs.from_directions(*torch.tensor([[[0.6, 0.0, 0.8]], [[0.0, 0.6, 0.8]]]).half())
            >>> half.tan2_h, half.widened().tan2_h
            (tensor([0.2815], dtype=torch.float16), tensor([0.2815]))
        """
        if not any(value.dtype in HALVES for value in self._known.values()):
            return self
        wide = self.to(dtype=torch.float32)
        wide._cached = {}
        # What was given comes first, and what was derived of it later.
        known, given = wide._known, next((name for name in wide._known if name in ("wi", "theta_h")), "")
        if given == "wi" and "wo" in known:
            return Pairs.from_directions(known["wi"], known["wo"])
        if given == "theta_h" and "theta_d" in known and "phi_d" in known:
            return Pairs.from_half_diff(known["theta_h"], known["theta_d"], known["phi_d"], known.get("phi_h"))
        return wide

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "Pairs":
        """The same pairs on another device or in another floating-point dtype.

        Args:
            device: where to; None: where they are.
            dtype: of every quantity but `above_horizon`, which is bool; None: as it is.

        Returns:
            Pairs whose tensors are the same where nothing changes.

        Example:
            >>> import torch
            >>> from torchbrdf import Pairs
            >>> Pairs.from_cosines(torch.tensor([0.5])).to(dtype=torch.float64).cos_i
            tensor([0.5000], dtype=torch.float64)
        """
        return self._map(lambda value, _: value.to(device, None if value.dtype == torch.bool else dtype))


def take(value: Tensor, index: Tensor | slice | list[int], dim: int) -> Tensor:
    """The part of one dimension that a slice (as a view), a list or an index tensor names."""
    if isinstance(index, slice):
        return value[(slice(None),) * dim + (index,)]
    if not isinstance(index, Tensor):
        index = torch.tensor(index, dtype=torch.int64, device=value.device)
    return value.index_select(dim, index.to(value.device))
