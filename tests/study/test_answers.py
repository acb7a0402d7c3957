"""Answers, the files that keep them, and those of other people: one meaning for a file, or a line that says why not."""

import csv
import io
import logging
import math
import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from torchbrdf.errors import DataError
from torchbrdf.study import Answer, read_answers, simulated, write_answers
from torchbrdf.study.answers import COLUMNS

# Names that something else could be read into, and names of any printable characters.
TRICKY = ("1", "2", "0", "1.0", "01", "left", "Right", "true", "=1+1", "'=1", "'", "-3", "@a", "a,b", "a;b", 'a"b')
TRICKY += (" a", "a ", "a\u00a0b", "\u00a0", "a/b", "sep=;", "\ufdfa", "\U0001f600", "e\u0301", "\u0661", "nan", "$x$")
SEEN = st.characters(exclude_categories=["C", "Zl", "Zp"])
NAMES = st.one_of(st.sampled_from(TRICKY), st.text(SEEN, min_size=1, max_size=8)).filter(lambda name: name.strip())


@st.composite
def answer(draw):
    left, right = draw(st.lists(NAMES, min_size=2, max_size=2, unique=True))
    return Answer(
        draw(NAMES),
        draw(st.one_of(st.just(""), NAMES)),
        draw(st.one_of(st.just(""), NAMES)),
        left,
        right,
        draw(st.sampled_from([left, right])),
        draw(st.one_of(st.floats(0, 1e7), st.floats(0, 1000).map(lambda time: round(time, 3)))),
        draw(st.sampled_from(["", "2026-11-25T10:00:00.000Z"])),
        draw(st.one_of(st.none(), st.integers(-(10**37), 10**37))),
        draw(st.sampled_from(["trial", "repeat", "catch"])),
    )


@settings(max_examples=150)
@given(st.lists(answer(), min_size=1, max_size=5))
def test_answers_are_read_as_they_were_written(tmp_path_factory, answers):
    path = tmp_path_factory.mktemp("answers") / "answers.csv"
    write_answers(path, answers)
    assert read_answers(path) == answers


def test_no_cell_that_is_written_is_a_formula(tmp_path):
    path = tmp_path / "answers.csv"
    write_answers(path, [Answer("=cmd()", "+1", "-m", "@left", "'=b", "'=b")])
    cells = path.read_text().splitlines()[1].split(",")
    assert cells[:5] == ["'=cmd()", "'+1", "'-m", "'@left", "''=b"]


def test_the_columns_are_those_of_pwcmp(tmp_path):
    path = tmp_path / "answers.csv"
    write_answers(path, [Answer("o1", "1", "nickel", "a", "b", "b", 1.5, "2026-11-25T10:00:00.000Z", 3)])
    head, row = path.read_text().splitlines()
    assert head.split(",")[:6] == ["observer", "session", "scene", "condition_1", "condition_2", "selection"]
    assert row == "o1,1,nickel,a,b,2,1.500,2026-11-25T10:00:00.000Z,3,trial"


# --- what selections mean ---------------------------------------------------------------------------------------------

SHORT = st.one_of(st.sampled_from(["0", "1", "2", "3", "1.0", "left", "right", "true"]), st.text("012ab", min_size=1))
TRIALS = st.lists(st.tuples(st.lists(SHORT, min_size=2, max_size=2, unique=True), st.booleans()), min_size=1)


def said(pair, first, meaning):
    """What a row's selection is under a meaning."""
    first_said = {"names": pair[0], "places": "1", "first_or_not": "1"}
    return (first_said if first else {"names": pair[1], "places": "2", "first_or_not": "0"})[meaning]


def written(folder, column, trials, meaning):
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(["observer", "left", "right", column])
    rows.writerows(["o", *pair, said(pair, first, meaning)] for pair, first in trials)
    path = folder / "answers.csv"
    path.write_text(text.getvalue(), newline="")
    return path


@settings(max_examples=300)
@given(
    TRIALS,
    st.sampled_from(
        [("selection", meaning) for meaning in ("names", "places", "first_or_not")]
        + [("chosen", "names"), ("chosen", "places")]
        + [("chosen_name", "names"), ("chosen_place", "places"), ("is_A_selected", "first_or_not")]
    ),
)
def test_selections_are_read_right_or_refused(tmp_path_factory, trials, how):
    column, meaning = how
    path = written(tmp_path_factory.mktemp("selections"), column, trials, meaning)
    try:
        found = read_answers(path)
    except DataError as error:
        assert column in ("selection", "chosen")
        assert "no row settles it; call the column chosen_place, chosen_name or is_A_selected" in str(error)
    else:
        assert [one.chosen for one in found] == [pair[0 if first else 1] for pair, first in trials]


@pytest.mark.parametrize("name", [str, "q{}".format], ids=["numbers", "names"])
def test_places_of_numbered_stimuli_are_places_in_every_row(tmp_path, name):
    trials = [((name(a), name(b)), a > b) for a in range(1, 5) for b in range(1, 5) if a != b]
    found = read_answers(written(tmp_path, "selection", trials, "places"))
    assert all(one.chosen == name(max(int(one.left[-1]), int(one.right[-1]))) for one in found)


def test_a_file_that_may_mean_either_is_refused(tmp_path):
    path = written(tmp_path, "selection", [(("1", "2"), True), (("2", "1"), False)], "places")
    with pytest.raises(DataError, match=r"line 3: selection: '2' may be 1, 2, left or right, or the name"):
        read_answers(path)


def test_names_and_places_in_one_file_are_refused(tmp_path):
    path = tmp_path / "answers.csv"
    path.write_text("observer,left,right,chosen\no,a,b,b\no,a,b,1\n")
    with pytest.raises(DataError, match="line 3: chosen: expected the name of one of the two, as in the rows before"):
        read_answers(path)


# --- other people's files ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "Observer,Session,Scene,Condition_1,Condition_2,Selection\no1,1,nickel,a,b,2\n",
        "observer;material;left;right;chosen\no1;nickel;a;b;b\n",
        "\ufeffsubject\tcontent\tA\tB\tchoice\r\no1\tnickel\ta\tb\tright\r\n\r\n",
        'chosen,left,right,material,observer\nb,"a",b,nickel,o1\n',
        "observer,scene,condition_1,condition_2,selection\ro1,nickel,a,b,2\r",
        "observer,scene,condition_1,condition_2,selection,response_time\no1,nickel,a,b,2.0,soon\n\n,,,,,\n\n\n",
        "sep=;\nobserver;scene;condition_1;condition_2;selection\no1;nickel;a;b;2\n",
        '"sep=;"\r\n\r\nobserver;scene;condition_1;condition_2;selection\r\no1;nickel;a;b;2\r\n',
        "sep=|\nobserver|scene|condition_1|condition_2|selection\no1|nickel|a|b|2\n",
        '"observer";"one, two, three, four, five, six";scene;"condition_1";"condition_2";"selection"\n'
        'o1;"x";nickel;a;b;"2"\n',
        "observer,material,left,right,chosen\no1,nickel,a,b,RIGHT\n",
        "observer, scene, condition 1, condition-2, selection\no1, nickel, a, b, 2,,\n",
        "observer,session_id,scene,condition_A,condition_B,is_A_selected\no1,1,nickel,a,b,0\n",
        "observer,session_id,scene,condition_B,condition_A,selected_A,criterion\no1,1,nickel,b,a,FALSE,x\n",
        "observer;scene;condition_1;condition_2;selection\no1;nickel;\u00a0a;b\u00a0;2,0\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-16"])
def test_other_peoples_files_are_understood(tmp_path, text, encoding):
    path = tmp_path / "answers.csv"
    path.write_text(text.removeprefix("\ufeff" if encoding == "utf-16" else ""), encoding=encoding, newline="")
    (found,) = read_answers(path)
    assert (found.observer, found.material, found.left, found.right, found.chosen) == ("o1", "nickel", "a", "b", "b")
    assert found.experiment in ("", "1") and math.isnan(found.response_time) and found.kind == "trial"


def test_an_observers_sittings_are_no_experiments(tmp_path):
    path = tmp_path / "answers.csv"
    path.write_text("observer,session_id,condition_A,condition_B,is_A_selected\no1,1,a,b,1\no2,3,b,a,0\no2,4,a,c,1\n")
    assert {one.experiment for one in read_answers(path)} == {""}


def test_a_decimal_comma_is_read_where_it_cannot_be_a_separator(tmp_path):
    path = tmp_path / "answers.csv"
    path.write_text("observer;left;right;chosen;response_time\no;a;b;a;1,25\n")
    assert read_answers(path)[0].response_time == 1.25
    path.write_text('observer,left,right,chosen,response_time\no,a,b,a,"1,250"\n')
    assert math.isnan(read_answers(path)[0].response_time)


def test_what_is_not_needed_counts_as_missing_and_the_log_says_so(tmp_path, caplog):
    path = tmp_path / "answers.csv"
    rows = ["soon,1", "-1,2", "inf,3", "1e300,4", "2,seven", "3,1e5", ",", f"4,{'9' * 60}"]
    path.write_text(HEAD + "".join(f"o,m,a,b,a,{row},\n" for row in rows))
    with caplog.at_level(logging.WARNING, "torchbrdf"):
        found = read_answers(path)
    assert [one.response_time for one in found[4:6]] == [2, 3] and found[7].response_time == 4
    assert all(math.isnan(one.response_time) for one in (*found[:4], found[6]))
    assert [one.seed for one in found] == [1, 2, 3, 4, None, None, None, None]
    first, second = caplog.messages
    assert "response_time that cannot be read counts as missing, in 4 answers; the first" in first
    assert "line 2: 'soon'" in first and "seed that cannot be read counts as missing, in 3 answers" in second


HEAD = "observer,material,left,right,chosen,response_time,seed,kind\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "found an empty file"),
        ("\n\r\n  \n", "found an empty file"),
        ("sep=;\n", "found an empty file"),
        (HEAD, "expected answers, found none"),
        ("observer,left,right\no,a,b\n", "expected a column selection or "),
        ("observer,left,a,right,chosen\n", "expected one column for condition_1, found left, a"),
        (
            HEAD + "o,m,a,b,c,,,\n",
            "line 2: chosen: expected 1, 2, left or right; or the name of one of the two, found 'c'",
        ),
        (
            HEAD + "o,m,a,b,0,,,\n",
            "line 2: chosen: expected 1, 2, left or right; or the name of one of the two, found '0'",
        ),
        (HEAD + "o,m,a,b,a,,,\no,m,a,b\n", "line 3: expected 8 columns, found 4"),
        ("sep=,\n" + HEAD + "o,m,a,b,a,,,\no,m,a,b\n", "line 4: expected 8 columns, found 4"),
        (HEAD + ",m,a,b,a,,,\n", "observer: expected a name"),
        (HEAD + "o,m,a,a,1,,,\n", "expected two stimuli, found 'a' twice"),
        (HEAD + "o,m,a,b,a,,,practice\n", "kind: expected one of trial, repeat, catch"),
        (HEAD + 'o,m,"a,b,a,,,\n', "expected CSV"),
        (
            HEAD + 'o,m,"a\n",b,a,,,\no,m,"a\nb",b,b,,,\n',
            "line 5: answer: expected names of one line, up to 200 long, found 'a\\nb'",
        ),
        (HEAD + f"o,m,{'a' * 201},b,2,,,\n", "expected names of one line, up to 200 long, found 'aaa"),
        (HEAD + "o,m,a\x1bb,b,b,,,\n", "expected names of one line, up to 200 long, found 'a\\x1bb'"),
        (
            HEAD.replace("seed", '"s\n\n' + "x" * 9000 + '"').replace("left", "'$\\bad{'"),
            "expected a column condition_1",
        ),
    ],
)
def test_bad_files_say_where(tmp_path, text, said):
    path = tmp_path / "answers.csv"
    path.write_text(text)
    with pytest.raises(DataError, match=r"answers\.csv") as caught:
        read_answers(path)
    assert said in str(caught.value) and "\n" not in str(caught.value) and len(str(caught.value)) <= 300


def test_other_encodings_are_named(tmp_path):
    path = tmp_path / "answers.csv"
    path.write_bytes((HEAD + "o,m,\u00e4,b,b,,,\n").encode("cp1252"))
    with pytest.raises(DataError, match=r"answers\.csv: expected answers as text in UTF-8 \(in Excel: save as CSV UTF"):
        read_answers(path)


@given(st.one_of(st.binary(max_size=200), st.text(max_size=200).map(lambda s: (HEAD + s).encode(errors="replace"))))
def test_no_bytes_make_reading_fail_in_another_way(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("answers") / "answers.csv"
    path.write_bytes(data)
    try:
        assert read_answers(path)
    except DataError as error:
        assert "answers.csv" in str(error)


def test_columns_that_are_not_read_are_named_and_counts_are_refused(tmp_path, caplog):
    path = tmp_path / "answers.csv"
    path.write_text("observer,a,b,winner,mood,count\nx,p,q,p,good,1\n")
    assert len(read_answers(path)) == 1
    assert "columns that are not read: mood, count" in caplog.text
    path.write_text("observer,a,b,winner,count\nx,p,q,p,17\n")
    with pytest.raises(DataError, match=r"answers\.csv: expected a row an answer, found a column 'count'"):
        read_answers(path)


def test_what_is_no_file_is_a_clear_error(tmp_path):
    os.mkfifo(tmp_path / "fifo.csv")
    for name, found in (("nowhere.csv", "no such file"), ("fifo.csv", "no regular file"), ("", "Is a directory")):
        with pytest.raises(DataError, match=f"expected answers, found {found}"):
            read_answers(tmp_path / name)


@pytest.mark.parametrize(
    "wrong",
    [{"observer": " "}, {"left": ""}, {"response_time": -1.0}, {"response_time": math.inf}, {"seed": 10**38}],
)
def test_answers_that_cannot_be_are_refused(wrong):
    with pytest.raises(DataError, match=f"answer: {next(iter(wrong))}: expected"):
        Answer(
            **({"observer": "o", "experiment": "", "material": "", "left": "a", "right": "b", "chosen": "b"} | wrong)
        )


def test_a_stimulus_may_be_called_2():
    assert Answer("o", "", "", "2", "1", "2").rejected == "1"


def test_simulated_observers_are_known_by_name():
    person, robot = (Answer(name, "", "", "a", "b", "a") for name in ("observer-001", "simulated-001"))
    assert simulated([person, robot]) and not simulated([person])


def test_ours_are_exactly_these_columns():
    assert ",".join(COLUMNS) == (
        "observer,session,scene,condition_1,condition_2,selection,response_time,time_stamp,seed,kind"
    )
