"""What a model is made of where derivatives are taken without a graph.

Such a model is a sum of coefficients times terms, f_c = sum_j A_cj s_j: of a colour times a scalar function for most
lobes, of several coloured terms for others. All derivatives then follow from a few responses a pair, the s_j and their
derivatives by the lobes' scalars, which all channels share, and from how the A_cj change, which no pair knows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import torch
from torch import Tensor

from torchbrdf.errors import UsageError
from torchbrdf.fitting.parameters import FreeParameter, Parametrization
from torchbrdf.lobes import Lobe
from torchbrdf.lobes.in_bands import channels_of
from torchbrdf.lobes.parameter_dict import ParameterDict, component_names, get_parameters
from torchbrdf.lobes.separable import coefficient_slopes, pattern
from torchbrdf.pairs import Pairs


def is_separable(model: Lobe) -> bool:
    """Whether every component is coefficients times terms."""
    return all(component.is_separable() for component in model.components())


@dataclass
class _Part:
    """A component that is present: its place in the model, its kind, and the full names of its parameters by its own.

    free: the full names of parameters that are moved.
    """

    component: int
    kind: type[Lobe]
    names: dict[str, str]
    free: set[str]

    def __post_init__(self) -> None:
        color = self.kind.albedo_spec()
        self.color = None if color is None else self.names[color.name]
        own_scalars = self.kind.term_scalars()
        self.scalars, self.sizes = [self.names[spec.name] for spec in own_scalars], [spec.size for spec in own_scalars]
        self.moves_terms = any(name in self.free for name in self.scalars)
        if self.color is not None:
            self.terms, self.slopes = 1, [(name, 0) for name in self.scalars if name in self.free]
            self.moves_coefficients = self.color in self.free
        else:
            own = pattern(self.kind)
            known = zip(self.scalars, own.slopes, strict=True)
            self.terms, self.slopes = own.terms, [(name, j) for name, js in known if name in self.free for j in js]
            self.moves_coefficients = any(self.names[name] in self.free for name in own.parameters)

    @property
    def own_free(self) -> set[str]:
        """The parameters that are moved, by their own names."""
        return {name for name, full in self.names.items() if full in self.free}

    def coefficients(self, values: ParameterDict, dtype: torch.dtype) -> Tensor:
        """A of this component, `(R, C, J)`."""
        if self.color is not None:
            return values[self.color].to(dtype).expand(-1, self.kind.channels)[..., None]
        return self.kind.coefficients(**self._own(values, dtype)).expand(-1, self.kind.channels, -1)

    def coefficient_slopes(self, values: ParameterDict) -> dict[str, Tensor]:
        """How they change with each parameter, by its full name, `(R, C, J, size)`, float64."""
        found = coefficient_slopes(self.kind, self._own(values, torch.float64))
        return {self.names[name]: slope for name, slope in found.items()}

    def responses(self, pairs: Pairs, values: ParameterDict, dtype: torch.dtype) -> tuple[list[Tensor], list[Tensor]]:
        """The derivatives of terms that are in use, and the terms, `(R|1, N)` each."""
        kind = self.kind
        scalars = [values[name].to(dtype).expand(-1, size) for name, size in zip(self.scalars, self.sizes, strict=True)]
        if self.color is not None:
            if scalars and not self.moves_terms:
                return [], [kind.unit_response(pairs, *scalars)]
            shape, *tangents = kind.value_and_jacobian(pairs, *scalars)
            slopes = [slope for slope, name in zip(tangents, self.scalars, strict=True) if name in self.free]
            return slopes, [shape]
        if not self.moves_terms:
            return [], kind.terms(pairs, *scalars)
        terms, slopes_of = kind.terms_and_jacobian(pairs, *scalars)
        by_name = dict(zip(self.scalars, slopes_of, strict=True))
        found = [by_name[name][j] for name, j in self.slopes]
        return [torch.zeros_like(terms[0]) if one is None else one for one in found], terms

    def _own(self, values: ParameterDict, dtype: torch.dtype) -> ParameterDict:
        specs = self.kind.parameter_specs
        return {name: values[full].to(dtype).expand(-1, *specs[name].shape) for name, full in self.names.items()}


def responses_of(
    parts: Sequence[_Part], pairs: Pairs, values: ParameterDict, dtype: torch.dtype
) -> tuple[list[Tensor], list[Tensor]]:
    """`_Part.responses` of parts that are alike, all in one call: those of one after those of the other, `(K R, N)`."""
    first = parts[0]
    if len(parts) == 1:
        return first.responses(pairs, values, dtype)
    own = {
        name: torch.cat([values[part.scalars[k]].expand(-1, size) for part in parts])
        for k, (name, size) in enumerate(zip(first.scalars, first.sizes, strict=True))
    }
    return first.responses(pairs, own, dtype)


class Basis:
    """The responses of the components that are present, and how they make up predictions and derivatives.

    They come in the order: derivatives of terms by scalars that are free, terms of the components whose coefficients
    are free, terms of the others. The last two make up a prediction, the first two, `used`, derivatives.
    """

    def __init__(self, parametrization: Parametrization) -> None:
        model, self.free = parametrization.model, parametrization.free
        free_names = {name for one in self.free for name in one.names}
        self.channels = channels_of(model)
        names = component_names(model)
        parts = []
        for k in parametrization.components:
            kind = type(model.components()[k])
            if not kind.is_separable():
                raise UsageError(f"{kind.__name__}: is no coefficients times terms")
            parts.append(_Part(k, kind, names[k], free_names & {*names[k].values()}))
        self.parts = sorted(parts, key=lambda part: not part.moves_coefficients)
        self.slopes = [slope for part in self.parts for slope in part.slopes]
        self.terms = sum(part.terms for part in self.parts)
        self.alike = [list(own) for _, own in groupby(self.parts, lambda part: (part.kind, frozenset(part.own_free)))]
        self.used = len(self.slopes) + sum(part.terms for part in self.parts if part.moves_coefficients)

    def albedos(self, values: ParameterDict, dtype: torch.dtype) -> Tensor:
        """The coefficients of each term, `(R, C, terms)`."""
        return torch.cat([part.coefficients(values, dtype) for part in self.parts], 2)

    def responses(self, pairs: Pairs, values: ParameterDict, dtype: torch.dtype) -> list[Tensor]:
        """All responses on some pairs, `(R|1, N)` each."""
        found = [part.responses(pairs, values, dtype) for part in self.parts]
        return [one for slopes, _ in found for one in slopes] + [one for _, terms in found for one in terms]

    def stacked(self, pairs: Pairs, values: ParameterDict, dtype: torch.dtype, problems: int) -> Tensor:
        """The same as one tensor, `(R, Q, N)`."""
        return torch.stack([one.expand(problems, -1) for one in self.responses(pairs, values, dtype)], 1)

    def predict(self, albedos: Tensor, responses: Tensor) -> Tensor:
        """Values of all components, `(R, C, N)`, from stacked responses."""
        return torch.bmm(albedos, responses[:, len(self.slopes) :])

    def jacobian(self, values: ParameterDict, albedos: Tensor) -> Tensor:
        """How the used responses make up the derivative of each channel by each of P free numbers, `(R, C, Q, P)`."""
        found = (albedos.flatten(0, 1) @ self._of_scalars.to(albedos.device)).view(len(albedos), *self._constant.shape)
        logs, spread, others = self._logs
        if logs:
            rate = torch.cat([values[name] for name in logs], 1).to(albedos)
            found = found * torch.addmm(others.to(albedos.device), rate, spread.to(albedos.device))[:, None, None]
        found = found + self._constant.to(albedos.device)
        for part, first in zip(self.parts, self._first_terms, strict=True):
            if part.color is None:
                self._add_coefficients(found, part, first, values, albedos)
        return found

    @cached_property
    def _constant(self) -> Tensor:
        """What of the jacobian is always the same, as values are linear in colours, `(C, Q, P)`."""
        size = self.used, sum(one.width for one in self.free)
        found = torch.zeros(self.channels, *size, dtype=torch.float64, device="cpu")
        for part, first in zip(self.parts, self._first_terms, strict=True):
            for name, one, columns in self._columns:
                if part.color is not None and name == part.color:
                    for channel in range(self.channels):
                        column = columns.start + (channel if one.width > 1 else 0)
                        found[channel, len(self.slopes) + first, column] = 1
        return found

    @cached_property
    def _of_scalars(self) -> Tensor:
        """Which coefficients a derivative by a scalar of a lobe with a colour is multiplied by, `(terms, Q P)`."""
        found = torch.zeros(self.terms, *self._constant.shape[1:], dtype=torch.float64, device="cpu")
        for part, first in zip(self.parts, self._first_terms, strict=True):
            for name, _, columns in self._columns:
                if part.color is not None and name != part.color and name in part.free:
                    found[first, self._rows[name, 0], columns.start] = 1
        return found.flatten(1)

    @cached_property
    def _logs(self) -> tuple[list[str], Tensor, Tensor]:
        """Scalars whose logarithms are moved, which of P numbers each is, `(k, P)`, and 1 for the other numbers."""
        scalars = {name for part in self.parts if part.color is not None for name in part.scalars}
        found = {columns.start: name for name, one, columns in self._columns if one.spec.log and name in scalars}
        spread = torch.zeros(len(found), sum(one.width for one in self.free), dtype=torch.float64, device="cpu")
        spread[range(len(found)), list(found)] = 1
        return list(found.values()), spread, 1 - spread.sum(0)

    @cached_property
    def _first_terms(self) -> list[int]:
        """Of each part which term is its first."""
        counts = [part.terms for part in self.parts]
        return [sum(counts[:k]) for k in range(len(counts))]

    @cached_property
    def _rows(self) -> dict[tuple[str, int], int]:
        """Of each derivative, by the scalar's full name and the term of its component, which response it is."""
        return {slope: row for row, slope in enumerate(self.slopes)}

    @cached_property
    def _columns(self) -> list[tuple[str, FreeParameter, slice]]:
        """The full names that are moved, by what, and which numbers of the vector it is."""
        found, p = [], 0
        for one in self.free:
            found += [(name, one, slice(p, p + one.width)) for name in one.names]
            p += one.width
        return found

    def _add_coefficients(self, found: Tensor, part: _Part, first: int, values: ParameterDict, albedos: Tensor) -> None:
        changes = part.coefficient_slopes(values) if part.moves_coefficients else {}
        own = slice(len(self.slopes) + first, len(self.slopes) + first + part.terms)
        for name, one, columns in self._columns:
            if name not in part.free:
                continue
            rate = values[name].double() if one.spec.log else torch.ones_like(values[name], dtype=torch.float64)
            rate = rate.expand(-1, one.spec.size)
            for j in range(part.terms):
                if (name, j) in self._rows:
                    own_number = j if one.spec.per_channel else 0  # a number a channel: term j takes the j-th
                    column = columns.start + (own_number if one.width > 1 else 0)
                    found[:, :, self._rows[name, j], column] += albedos[:, :, first + j] * rate[:, own_number, None]
            if name in changes:
                slope = changes[name] * rate[:, None, None]
                found[:, :, own, columns] += slope if one.width == one.spec.size else slope.sum(-1, keepdim=True)


def predictor(model: Lobe) -> Callable[[Pairs], Tensor]:
    """A function that gives a model's values on pairs, `(M, C, N)`: channel by channel where that is faster."""
    if not is_separable(model):
        return lambda pairs: model(pairs).mT
    basis, values = Basis(Parametrization(model, [])), get_parameters(model)
    dtype = next(iter(values.values())).dtype
    albedos = basis.albedos(values, dtype)
    return lambda pairs: basis.predict(albedos, basis.stacked(pairs, values, dtype, len(albedos)))
