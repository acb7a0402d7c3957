"""The learned metric's constants: in the file that comes with torchbrdf, one's own, and wrong ones."""

import copy
import json
import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from torchbrdf.errors import DataError
from torchbrdf.losses import LOSSES, LearnedLoss
from torchbrdf.losses.metric_file import CONSTANTS, read_metric


def test_the_docstring_has_the_constants_that_come_with_it() -> None:
    said = dict(re.findall(r"w\d  (\w+) +([\d.]+)", LearnedLoss.__doc__ or ""))
    assert {name: float(value) for name, value in said.items()} == read_metric(None)["constants"]
    assert list(read_metric(None)["constants"]) == list(CONSTANTS)


def test_it_comes_by_name_and_says_where_it_is_from() -> None:
    loss = LOSSES["learned"]()
    assert isinstance(loss, LearnedLoss) and loss.registered_name == "learned"
    assert {"learned_from", "held_out"} <= set(loss.provenance)
    assert "10.1145/3306346.3323036" in json.dumps(loss.provenance)


NAMES = ", ".join(CONSTANTS)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda d: d.pop("constants"), f"expected constants {NAMES}; found none"),
        (
            lambda d: d.update(weights={"pointwise": [1.0] * 5}) or d.pop("constants"),
            f"expected constants {NAMES}; found the weights of an older form: train it again",
        ),
        (lambda d: d.update(epsilon=1.0), "epsilon: expected 0.001, found 1.0"),
        (lambda d: d.update(theta_h=[0, 90]), r"theta_h: expected .*, found \[0.0, 90.0\]"),
        (lambda d: d.update(provenance="mine"), "expected a learned metric, .* got `str` - at `\\$.provenance`"),
        (lambda d: d.update(provenance=["mine"]), "expected a learned metric, .* got `array` - at `\\$.provenance`"),
        (lambda d: d["constants"].pop("gloss"), f"constants: expected {NAMES}; found 'chroma, bins, pointwise'"),
        (
            lambda d: d["constants"].update(more=1.0),
            f"constants: expected {NAMES}; found 'gloss, chroma, bins, pointwise, m",
        ),
        (lambda d: d["constants"].update(gloss=-1.0), r"constants: gloss: expected 0 to 1e\+20, found -1.0"),
        (lambda d: d["constants"].update(gloss=1e300), r"constants: gloss: expected 0 to 1e\+20, found 1e\+300"),
        (lambda d: d["constants"].update(gloss=10**400), "expected a learned metric, .*where a finite number"),
        (lambda d: d["constants"].update(gloss=float("nan")), r"expected a learned .*nan at `\$.constants.gloss`"),
        (lambda d: d.update(constants="much"), "expected a learned metric, .*got `str`"),
        (lambda d: d.update(constants=dict.fromkeys(CONSTANTS, 0.0)), "expected a constant above 0, found none"),
    ],
)
def test_bad_constants_are_refused(change, said: str, tmp_path: Path) -> None:
    data = copy.deepcopy(dict(read_metric(None)))
    change(data)
    path = tmp_path / "metric.json"
    path.write_text(json.dumps(data))
    with pytest.raises(DataError, match=f"^{path}: {said}") as caught:
        LearnedLoss(weights=path)
    assert len(str(caught.value)) <= 300 and "\n" not in str(caught.value)
    if "JSON" not in said and "range" not in said:
        with pytest.raises(DataError, match=r"^weights: "):
            LearnedLoss(weights=data)


def test_deep_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "metric.json").write_text('{"provenance": {"a": ' + "[" * 100_000)
    with pytest.raises(DataError, match=r"metric.json: expected a learned metric, .*, found JSON that is nested too"):
        LearnedLoss(weights=tmp_path / "metric.json")


@given(st.text(max_size=60) | st.recursive(st.none() | st.floats() | st.text(), st.lists).map(json.dumps))
@settings(max_examples=60, deadline=None)
def test_whatever_a_file_holds_is_a_metric_or_an_error(tmp_path_factory, text: str) -> None:
    path = tmp_path_factory.mktemp("metric") / "metric.json"
    path.write_text(text, encoding="utf-8", errors="replace")
    with pytest.raises(DataError, match=r"metric\.json: expected"):
        LearnedLoss(weights=path)
