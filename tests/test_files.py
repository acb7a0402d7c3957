"""Files that are written whole or not at all."""

import csv
import json
import math

import pytest

from torchbrdf.errors import DataError
from torchbrdf.files import csv_text, write_csv, write_json
from torchbrdf.progress import part_of


def test_json_has_null_for_what_it_has_no_word_for(tmp_path):
    write_json(tmp_path / "x.json", {"a": [1.5, math.nan, (math.inf, 2)], "b": {"c": -math.inf}, "d": True})
    found = json.loads((tmp_path / "x.json").read_text(), parse_constant=pytest.fail)
    assert found == {"a": [1.5, None, [None, 2]], "b": {"c": None}, "d": True}


def test_csv_has_every_key_once(tmp_path):
    write_csv(tmp_path / "x.csv", [{"a": 1, "b": 'two, "2"'}, {"c": None, "a": 3}])
    with (tmp_path / "x.csv").open(newline="") as file:
        assert list(csv.reader(file)) == [["a", "b", "c"], ["1", 'two, "2"', ""], ["3", "", ""]]
    assert "\r" not in csv_text([{"a": 1}])


def test_a_value_that_json_cannot_hold_leaves_the_file_as_it_was(tmp_path):
    path = tmp_path / "x.json"
    path.write_text("before")
    with pytest.raises(TypeError):
        write_json(path, [object()])
    assert [one.read_text() for one in tmp_path.iterdir()] == ["before"]
    with pytest.raises(DataError, match="cannot be written"):
        write_json(path / "below.json", [])


def test_a_part_counts_on_from_what_was_done_before():
    calls = []
    part = part_of(lambda done, total: calls.append((done, total)), 10, 30)
    part(1, 5)
    part(5, 5)
    assert calls == [(11, 30), (15, 30)]
