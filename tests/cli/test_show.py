"""prolearn show: a page from a plan file, and one sentence where there is none to be had."""

import json

import pytest

from pipeline.expert import decoupled_optima, solve
from pipeline.orbit.problem import Problem
from pipeline.plan.document import plan_document, write_plan
from pipeline.plan.judge import Draft, certified_plan
from pipeline.scenario import draw

SCENARIO = draw("rings", 0, 10, 3, Problem())


@pytest.fixture
def document():
    return json.loads(json.dumps(plan_document(solve(SCENARIO))))


def test_a_page_is_written_beside_the_plan_or_where_one_says(run, tmp_path):
    write_plan(tmp_path / "swarm.json", solve(SCENARIO))
    done = run("show", "swarm.json")
    assert (done.returncode, done.stdout) == (0, "swarm.html: 10 craft by expert.\n")
    done = run("show", "swarm.json", "--out", "pages/look.html")
    assert done.returncode == 0, done.stderr
    pages = [tmp_path / "swarm.html", tmp_path / "pages" / "look.html"]
    assert pages[0].read_bytes() == pages[1].read_bytes()
    assert "Transfer of 10 craft, planned by expert" in pages[0].read_text()


def test_an_unsafe_plan_is_shown_and_called_so(run, tmp_path):
    own = decoupled_optima(SCENARIO.initial, SCENARIO.goal, SCENARIO.problem)
    draft = Draft(own.controls, float(own.lower_bound.sum()))
    plan = certified_plan("decoupled optimum", SCENARIO, draft)
    write_plan(tmp_path / "plan.json", plan)
    done = run("show", "plan.json")
    i, j = plan.certificate.min_separation_pair
    assert done.returncode == 0
    assert f"unsafe: craft {i} and {j} come within" in done.stdout
    text = (tmp_path / "plan.html").read_text()
    assert text.index("<strong>Unsafe</strong>") < text.index("<h2>")


def without_scenario(document):
    document["schema"] = "prolearn.plan/1"
    del document["scenario"]


def no_number(document):
    document["controls"][2][3][0] = float("nan")


def too_much(document):
    document["controls"][2][3][0] = 1e300


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without_scenario, "schema prolearn.plan/1, which leaves out the scenario"),
        (no_number, "controls[2][3][0] is nan"),
        (too_much, "the controls reach 1e+300 m/s²"),
        (lambda document: document.pop("states"), "states is missing"),
    ],
    ids=["version 1", "NaN", "overflow", "no states"],
)
def test_a_plan_that_cannot_be_shown_is_answered_in_a_sentence(
    run, tmp_path, document, change, words
):
    change(document)
    (tmp_path / "plan.json").write_text(json.dumps(document))
    done = run("show", "plan.json")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert words in done.stderr
    assert "plan.json" in done.stderr
    assert not (tmp_path / "plan.html").exists()


@pytest.mark.parametrize(
    ("plan", "out"), [("plan.html", None), ("plan.json", "plan.json"), ("plan.json", ".")]
)
def test_a_page_never_takes_the_place_of_the_plan_or_a_folder(run, tmp_path, document, plan, out):
    (tmp_path / plan).write_text(json.dumps(document))
    before = (tmp_path / plan).read_bytes()
    done = run("show", plan, *(["--out", out] if out else []))
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert (tmp_path / plan).read_bytes() == before
