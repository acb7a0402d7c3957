"""What people are asked, what they answered, and what others published about them."""

import json
import sqlite3
from pathlib import Path

import numpy as np
import torch
from helpers.study_folder import EXPERIMENT, REPORTS, SCREEN, make_study, ready
from scipy.io import savemat

from fuzzing.changes.byte import TEXT
from fuzzing.changes.of_arrays import mat
from fuzzing.changes.of_formats import database
from fuzzing.changes.of_json import JSON
from fuzzing.changes.of_table import TABLE
from fuzzing.readers import Reader
from fuzzing.sane import check_brdf, check_finite, check_line, check_name, check_pairs, expect, later
from torchbrdf.measured.catalogue import MERL_NAMES
from torchbrdf.perception import (
    read_factors,
    read_jod,
    read_lagunas,
    read_opinions,
    read_published,
    read_ratings,
    read_triplets,
    score_jod,
)
from torchbrdf.perception.discrimination.psychometric import read_discrimination
from torchbrdf.psychophysics import Comparisons, scale
from torchbrdf.study import Answer, Plan, read_answers, simulate, trials, write_answers
from torchbrdf.study.server import make_app
from torchbrdf.study.store import STORE, Store


def make_plan(folder: Path) -> None:
    make_study(folder, materials=2, size=4)


def make_full_plan(folder: Path) -> None:
    make_study(folder, materials=2, size=4, repeats=2, catch=2)


def use_plan(path: Path) -> None:
    """As a server uses it: the page, an observer's trials; and as simulated observers do."""
    plan = Plan.load(path.parent)
    for material in plan.materials:
        check_line(material.name, "material")
        for name in material.stimuli:
            check_line(name, "stimulus")
    for experiment in plan.experiments:
        check_line(experiment.name, "experiment")
        shown = trials(plan, experiment, 1)
        expect(0 < len(shown) < 1_000_000, f"{len(shown)} trials")
        with later():
            simulate(plan, experiment, 1)
    store = Store(path.parent / STORE, plan)
    try:
        client = make_app(path.parent, plan.experiments[0].name, store).test_client()
        page = client.get("/")
        expect(page.status_code == 200, f"the page: status {page.status_code}")
        begun = client.post("/begin", json={"agreed": True})
        expect(begun.status_code == 201, f"the beginning: status {begun.status_code}")
    finally:
        store.close()
    plan.save(path.parent)
    expect(Plan.load(path.parent) == plan, "saved again it is another")


def use_pictures(path: Path) -> None:
    """As a server uses the pictures of a plan: whole ones are shown, of others the page says that it does not work."""
    plan = Plan.load(path.parents[1])
    store = Store(path.parents[1] / STORE, plan)
    try:
        client = make_app(path.parents[1], EXPERIMENT, store).test_client()
        link = ready(client)
        for trial in range(3):
            for what in ("reference", "left", "right"):
                shown = client.get(f"{link}/{trial}/{what}.png")
                expect(shown.status_code in (200, 503), f"a picture: status {shown.status_code}")
    finally:
        store.close()


def make_store(folder: Path) -> None:
    make_full_plan(folder)
    plan = Plan.load(folder)
    store = Store(folder / STORE, plan)
    for _ in range(2):
        token = store.begin(EXPERIMENT)
        store.report(token, REPORTS, True)
        store.record_screen(token, SCREEN)
        for position in range(5):
            store.answer(token, position, "left", 1.5)
    store.close()
    with sqlite3.connect(folder / STORE) as db:
        db.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (folder / "token.txt").write_text(token)
    db.close()


def use_store(path: Path) -> None:
    """As a server and an export use it."""
    store = Store(path, Plan.load(path.parent))
    try:
        for answer in store.answers():
            check_line(answer.observer, "observer")
            check_line(answer.material, "material")
            expect(answer.response_time >= 0 and answer.response_time < float("inf"), "response time")
        for profile in store.profiles():
            check_line(profile["observer"], "observer")
        write_answers(path.parent / "answers.csv", store.answers())
        with later():
            state = store.state((path.parent / "token.txt").read_text())
            expect(0 <= state.position <= state.trials, f"position {state.position} of {state.trials}")
        client = make_app(path.parent, EXPERIMENT, store).test_client()
        expect(client.post("/begin", json={"agreed": True}).status_code in (201, 503), "the beginning")
    finally:
        store.close()


def make_answers(folder: Path) -> None:
    source = np.random.default_rng(0)
    names = ("ward", "cook", "abc")
    given = []
    for observer in ("ann", "bob", "cyd"):
        for material in ("nickel", "nylon"):
            for left, right in (("ward", "cook"), ("cook", "abc"), ("abc", "ward")):
                chosen = min((left, right), key=names.index) if source.uniform() < 0.8 else right
                given.append(Answer(observer, "gloss", material, left, right, chosen, 1.25, "2026-01-01T10:00:00Z", 7))
    write_answers(folder / "fuzzed.csv", given)


def use_answers(path: Path) -> None:
    """As scales use it."""
    answers = read_answers(path)
    for answer in answers:
        for name in ("observer", "experiment", "material", "left", "right"):
            check_line(getattr(answer, name), name)
        expect(answer.chosen in (answer.left, answer.right) and answer.left != answer.right, "no choice")
        expect(not answer.response_time < 0 and answer.response_time != float("inf"), f"{answer.response_time} seconds")
    write_answers(path.parent / "again.csv", answers)
    again = read_answers(path.parent / "again.csv")
    expect([one.chosen for one in again] == [one.chosen for one in answers], "written again it says something else")
    with later():
        comparisons = Comparisons.from_answers(answers, answers[0].experiment)
        check_finite(comparisons.wins, "wins")
        found = scale(comparisons, draws=0)
        for record in found.records():
            expect(np.isfinite([record["scale"], record["low"], record["high"]]).all(), "the scale is not finite")


def make_opinions(folder: Path) -> None:
    source = np.random.default_rng(0)
    lines = [f"{method},{material},{source.uniform():.3f}" for method in ("WARD", "SGD") for material in MERL_NAMES[:6]]
    (folder / "fuzzed.csv").write_text("\n".join(["method,material,distance", *lines]) + "\n")


def use_opinions(path: Path) -> None:
    """As scores use it."""
    found = read_opinions(path)
    for name in (*found.methods, *found.materials):
        check_line(name, "name")
    expect(len(found) > 0 and bool(((found.distance >= 0) & (found.distance <= 1)).all()), "a distance beyond 0 to 1")
    check_finite(found.standard_error, "standard error")


def make_jod(folder: Path) -> None:
    source = np.random.default_rng(0)
    lines = [
        f"{material}_{k},{model},{level},{source.uniform(1, 40):.3f},{source.uniform(2, 10):.3f},3"
        for material in MERL_NAMES[:4]
        for k, (model, level) in enumerate((("ward", 0), ("hbrdf", 0), ("hbrdf", 1)), 1)
    ]
    (folder / "fuzzed.csv").write_text("\n".join(["material,model,level,DeltaE,JOD,class", *lines]) + "\n")


def use_jod(path: Path) -> None:
    """As scores use it."""
    found = read_jod(path)
    for name in (*found.names, *found.materials, *found.methods):
        check_name(name, "name")
    expect(len(found) > 0 and len(set(found.names)) == len(found), "no rows, or a name twice")
    check_finite(torch.stack([found.distance, found.delta_e]), "a score")
    with later():
        check_finite(score_jod(found, replicates=3).table.value, "agreement")


def make_ratings(folder: Path) -> None:
    source = np.random.default_rng(0)
    lines = [
        f"{name},{source.integers(2, 15)},{source.uniform(1, 5):.3f},{source.uniform(1, 5):.3f},0.25,0.5"
        for name in ("001.png", *(f"{material}_5PCs.png" for material in MERL_NAMES[:8]))
    ]
    head = "image,n,glossy_mean,refsharp_mean,glossy_sd,refsharp_sd"
    (folder / "fuzzed.csv").write_text("\n".join([head, *lines]) + "\n")


def use_ratings(path: Path) -> None:
    """As a page uses it."""
    found = read_ratings(path)
    for name in (*found.materials, *found.attributes):
        check_name(name, "name")
    expect(len(found) > 0 and bool(((found.mean >= 1) & (found.mean <= 5)).all()), "a mean beyond 1 to 5")
    check_finite(found.standard_error, "standard error")
    expect(bool((found.count > 0).all()), "nobody was asked")
    found.select([name for name, known in zip(found.materials, found.measured, strict=True) if known])


def make_triplets(folder: Path) -> None:
    source = np.random.default_rng(0)
    questions = [source.choice(100, 3, replace=False).tolist() for _ in range(12)]
    votes = source.integers(1, 6, (12, 2)).tolist()
    (folder / "fuzzed.json").write_text(json.dumps({"answers": questions, "agreement": votes}))


def use_triplets(path: Path) -> None:
    """As scores use it."""
    found = read_triplets(path)
    expect(len(found) > 0 and found.questions.shape == (len(found), 3), "no questions")
    expect(bool(((found.questions >= 0) & (found.questions < len(found.materials))).all()), "an index of no material")
    expect(bool((found.votes >= 0).all() and (found.votes.sum(1) > 0).all()), "votes below 0, or none")
    expect(len(found.select(found.decided)) <= len(found), "more decided than asked")


def make_discrimination(folder: Path) -> None:
    metric = {"slope": 2.5, "scale": 1.5, "spread": 0.4, "covariance": np.diag([0.01, 0.02, 0.03]).tolist()}
    metric |= {"lowest": 0.05, "highest": 3.0, "check": {"triplets": 0.02}}
    (folder / "fuzzed.json").write_text(json.dumps({"metrics": {"learned": metric}, "provenance": {"seed": 0}}))


def use_discrimination(path: Path) -> None:
    """As reports use it."""
    for name, metric in read_discrimination(path).metrics.items():
        check_line(name, "metric")
        for distance in (0.0, 1e-12, metric.lowest, metric.highest, 1e12):
            share = metric.share(distance)
            expect(0 <= share.low <= share.value <= share.high <= 1, f"a share of {share}")
        expect(metric.distance(0.25) <= metric.distance(0.75), "fewer tell apart what is farther apart")
        expect(0 <= metric.prefer(metric.lowest, metric.highest) <= 1, "a share of no observers")


def make_published(folder: Path) -> None:
    """Two materials of every set that is read."""
    color, numbers = [0.1, 0.2, 0.3], {"diffuse": [0.2, 0.1, 0.05], "specular": [0.01, 0.02, 0.03]}
    bagher = dict.fromkeys(("alpha", "p", "K", "Lambda", "c", "k", "theta0"), color)
    fits = {
        "ngan_ward": {**numbers, "model": "NganWard", "roughness": 0.1},
        "ngan_blinnphong": {**numbers, "model": "NganBlinnPhong", "sharpness": 100.0},
        "ngan_cooktorrance": {**numbers, "model": "NganCookTorrance", "roughness": 0.1, "eta": 0.5},
        "ngan_ashikhminshirley": {
            **numbers, "model": "NganAshikhminShirley", "sharpness": 50.0, "fresnelReflectance": 0.4
        },
        "low_lowmicrofacet_E2": {
            "diffuse": color, "model": "LowMicrofacetFit", "A": color, "B": 100.0, "C": 1.5, "eta": 1.5
        },
        "bagher_sgd": {**numbers, **bagher, "model": "Bagher", "eta": [color, color]},
    }  # fmt: skip
    (folder / "fuzzed.json").write_text(json.dumps({name: {"tin": fit, "zinc": fit} for name, fit in fits.items()}))


def use_published(path: Path) -> None:
    """As scores use it."""
    for fits in read_published(path, dtype=torch.float64).values():
        for name in fits.materials:
            check_name(name, "material")
        with later(), torch.no_grad():
            check_brdf(fits.of(fits.materials)(check_pairs()), f"values of {fits.name}")


def make_mat(folder: Path) -> None:
    source = np.random.default_rng(0)
    names = ("rms", "rms_cos", "rms_cos_cube", "dist_L2_lab", "dist_L4_lab")
    points = {name: source.normal(size=(4, 2)) for name in names}
    distances = {name: np.linalg.norm(at[:, None] - at, axis=-1) for name, at in points.items()}
    savemat(folder / "fuzzed.mat", distances, do_compression=True)


def use_mat(path: Path) -> None:
    """As scores use it."""
    for name, found in read_lagunas(path, materials=4).items():
        expect(found.shape == (4, 4) and found.dtype == torch.float64, f"{name}: no matrix")
        check_finite(found, name)
        expect(bool((found >= 0).all()), f"{name} below 0")


def make_factors(folder: Path) -> None:
    source = np.random.default_rng(0)
    source.uniform(0, 1, (256, 512, 3)).astype("<f4").tofile(folder / "fuzzed.bin")


def use_factors(path: Path) -> None:
    """As scores use it."""
    found = read_factors(path)
    with torch.no_grad():
        check_brdf(found.of(found.materials[:3])(check_pairs().to(dtype=torch.float32)), "values")


READERS = (
    Reader("study", "study.json", make_full_plan, use_plan, (*JSON, *TEXT), share=0.8),
    Reader("png", "renders/cobalt.png", make_plan, use_pictures, share=0.4),
    Reader("store", STORE, make_store, use_store, (database, database), share=0.5),
    Reader("answers", "fuzzed.csv", make_answers, use_answers, (*TABLE, *TEXT), renamed=True),
    Reader("opinions", "fuzzed.csv", make_opinions, use_opinions, (*TABLE, *TEXT), renamed=True),
    Reader("jod", "fuzzed.csv", make_jod, use_jod, (*TABLE, *TEXT), renamed=True),
    Reader("ratings", "fuzzed.csv", make_ratings, use_ratings, (*TABLE, *TEXT), renamed=True),
    Reader("triplets", "fuzzed.json", make_triplets, use_triplets, (*JSON, *TEXT), renamed=True),
    Reader("discrimination", "fuzzed.json", make_discrimination, use_discrimination, (*JSON, *TEXT), renamed=True),
    Reader("published", "fuzzed.json", make_published, use_published, (*JSON, *TEXT), renamed=True),
    Reader("mat", "fuzzed.mat", make_mat, use_mat, (mat, mat), renamed=True),
    Reader("factors", "fuzzed.bin", make_factors, use_factors, renamed=True, share=0.3),
)
