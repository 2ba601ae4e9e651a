"""The page as a file: one, small, closed to the outside and to what a name may hold."""

import hashlib
import re
import subprocess
import sys
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest

from pipeline.expert import solve
from pipeline.flight.world import Conditions, in_world
from pipeline.orbit.problem import Problem
from pipeline.planners.as_flown import AsFlown
from pipeline.planners.classical import Expert
from pipeline.scenario import draw
from pipeline.scenario.document import read_scenario
from pipeline.show import HERE, page

VENDOR = HERE / "vendor"
BUNDLE = VENDOR / "plotly-gl3d.min.js"
EXAMPLES = Path(__file__).parents[3] / "examples"
HOSTILE = '</script><script>alert(1)</script><img src="x" onerror="alert(2)">{{ 7*7 }}'


class Parts(HTMLParser):
    """Tags with their attributes, and text as a person reads it."""

    def __init__(self):
        super().__init__()
        self.tags, self.text = [], ""

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data):
        self.text += data


def parsed(text):
    parts = Parts()
    parts.feed(text)
    return parts


@pytest.fixture(scope="module")
def planned_swarm():
    """A plan for a swarm of any size."""

    def made(n):
        return solve(draw("rings", 0, n, 0, Problem()))

    return made


def test_a_page_of_30_craft_is_smaller_than_2_mb(planned_swarm):
    text, _ = page(planned_swarm(30), "plan.json")
    assert len(text.encode()) < 2_000_000


def test_the_page_refers_to_nothing_and_its_policy_forbids_all_but_its_own_scripts(planned_swarm):
    parts = parsed(page(planned_swarm(3), "plan.json")[0])
    links = [v for _, a in parts.tags for k, v in a.items() if k in {"src", "href", "action"}]
    assert links == ["data:,"]
    assert {"iframe", "object", "form", "base"}.isdisjoint(tag for tag, _ in parts.tags)
    (policy,) = (a["content"] for _, a in parts.tags if "http-equiv" in a)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert re.fullmatch(r"('sha256-[A-Za-z0-9+/]{43}=' ?){2}", rules["script-src"])
    assert not re.search(r"https?:|\*", policy)


def test_words_from_the_file_stay_words(planned_swarm):
    plan = planned_swarm(2)

    def saying(words):
        proof = replace(plan.certificate, fuel_lower_bound_proof=words)
        said = replace(plan, planner=words, message=words, status="unsolved", certificate=proof)
        return parsed(page(said, words)[0])

    parts = saying(HOSTILE)
    assert parts.text.count(HOSTILE) >= 6, "title, heading, name, reason, proof, planner"
    assert [tag for tag, _ in parts.tags] == [tag for tag, _ in saying("words").tags]


def test_the_same_plan_gives_the_same_bytes(planned_swarm):
    plan = planned_swarm(2)
    assert page(plan, "a")[0] == page(plan, "a")[0]


def test_plotlys_bundle_is_the_recorded_one_with_its_licence():
    record = (VENDOR / "README.md").read_text()
    assert hashlib.sha256(BUNDLE.read_bytes()).hexdigest() in record
    (version,) = re.findall(r"version \| ([0-9.]+) \|", record)
    assert f"v{version}\n" in BUNDLE.read_bytes()[:100].decode()
    assert (VENDOR / "LICENSE").read_text().startswith("MIT License")
    assert (VENDOR / "LICENSE").read_text() in page_of_one()


def page_of_one():
    return page(solve(draw("rings", 0, 1, 0, Problem())), "plan.json")[0]


def test_a_page_says_by_which_equations_craft_move_on_it():
    circle = draw("rings", 0, 1, 0, Problem())
    about = in_world(circle, Conditions())
    flown = AsFlown(Expert()).plan([about])[0]
    said = [page(plan, "p")[0] for plan in (solve(circle), solve(about), flown)]
    assert ["Clohessy-Wiltshire" in text for text in said] == [True, False, False]
    assert ["where the flight has craft" in text for text in said] == [False, False, True]


def test_a_single_crafts_verdict_names_the_margin_of_its_corridor():
    scenario = read_scenario(EXAMPLES / "station-docking.json")
    plan = solve(scenario)
    inside = plan.certificate.corridor
    text = parsed(page(plan, "p")[0]).text
    told = f"at {inside.time:.1f} s it is {inside.min_margin:.4f} m inside of it."
    assert "Reaches its goal" in text and told in text
    assert ", all craft, 0 to " in text
    cone = replace(scenario.corridors[0].inside, half_angle_deg=3.0)
    narrow = replace(scenario, corridors=(replace(scenario.corridors[0], inside=cone),))
    text = parsed(page(replace(plan, scenario=narrow), "p")[0]).text
    assert "Unsafe" in text and "Reaches its goal" not in text and "inside of it" not in text


def test_where_there_are_obstacles_the_closest_pair_is_said_to_be_of_craft():
    text = parsed(page(solve(read_scenario(EXAMPLES / "inspection.json")), "p")[0]).text
    assert ", the closest two craft" in text and "Separation of craft" in text


def test_of_what_is_not_ours_only_the_recorded_files_are_there():
    assert {p.name for p in VENDOR.iterdir()} == {"LICENSE", "README.md", "plotly-gl3d.min.js"}
    ours = [p for p in VENDOR.parent.iterdir() if p.is_file()]
    assert max(p.stat().st_size for p in ours) < 20_000, "no bundle lies among our own files"


def test_showing_needs_no_network_library_no_solver_and_no_drawing_library():
    heavy = {"torch", "cvxpy", "clarabel", "highspy", "mlflow", "matplotlib", "pandas"}
    code = f"import sys, pipeline.show; print(*({heavy!r} & set(sys.modules)))"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        cwd=Path(__file__).parents[3],
    )
    assert done.stdout.strip() == ""
