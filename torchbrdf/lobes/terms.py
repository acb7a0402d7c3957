"""What fits know of a lobe: that its values are coefficients times terms, with derivatives."""

from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.lobes.parameter import BoundedParameter
from torchbrdf.lobes.separable import Slopes, tangents
from torchbrdf.pairs import Pairs


class Separable:
    """Base of lobes: the part of one by which fits need no graph, where its values are coefficients times terms.

    A lobe that is an albedo times a scalar function has all of it; another one declares `terms` and `coefficients`, or
    is fitted by a graph. Derivatives are those of forward differentiation, unless a lobe declares its own.

    Example:
        >>> from torchbrdf.lobes import Lobe, Separable
        >>> issubclass(Lobe, Separable)
        True
    """

    parameter_specs: ClassVar[dict[str, BoundedParameter]] = {}
    """The declared parameters by name, those of base classes first."""
    scalars_of_terms: ClassVar[tuple[str, ...] | None] = None
    """The parameters that `terms` takes, in that order; None: all of one number."""
    function: ClassVar[Callable[..., Tensor]]
    """The functional form: `function(pairs, *parameters)`, `(..., N, 3)`."""

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
        return cls.terms.__func__ is not Separable.terms.__func__  # type: ignore[attr-defined]

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
        declared = cls.pair_factors.__func__ is not Separable.pair_factors.__func__  # type: ignore[attr-defined]
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
