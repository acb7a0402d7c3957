"""Progress of long work where no terminal shows it."""

from torchbrdf.cli import common


def test_a_line_comes_every_half_minute(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(common.time, "monotonic", lambda: now[0])
    progress = common.progress_bar("fits")
    for done in range(5):
        now[0] = 20.0 * done
        progress(done, 4)
    assert capsys.readouterr().err == "torchbrdf: fits: 2 of 4\n"
