"""The page in a real browser: what a person sees when the slider moves."""

import json
import shutil
import time
from dataclasses import replace

import numpy as np
import pytest
from clohessy import position
from judge import exact_step

import prolearn
from pipeline.expert import decoupled_optima, solve
from pipeline.orbit.corridors import Box, Corridor
from pipeline.orbit.participants import Obstacle
from pipeline.orbit.problem import Problem
from pipeline.plan.judge import Draft, certified_plan
from pipeline.scenario import draw
from pipeline.scenario.spacecraft import Spacecraft
from pipeline.show import page
from prolearn import Ring
from prolearn.views import HEIGHT

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    # WebGL without a graphics card
    *("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing"),
)
PATIENCE = 120  # s

CENTRES = """
    const balls = document.getElementById("space").data[0];
    const n = arguments[0], many = balls.x.length / n;
    const middle = (all, k) =>
        all.slice(k * many, (k + 1) * many).reduce((sum, one) => sum + one, 0) / many;
    return Array.from({length: n}, (_, k) => [balls.x, balls.y, balls.z].map((v) => middle(v, k)));
"""
"""Where the spheres are that Plotly has been given."""

RADIUS = """
    const balls = document.getElementById("space").data[0];
    const z = balls.z.slice(0, balls.z.length / arguments[0]);
    return (Math.max(...z) - Math.min(...z)) / 2;
"""

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        not (CHROMIUM and DRIVER), reason="needs Debian's packages chromium and chromium-driver"
    ),
]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield started
    finally:
        started.quit()


@pytest.fixture
def opened(browser, tmp_path):
    """Open the page of a plan; at the end nothing has gone wrong and nothing was asked for."""

    def shown(plan, name="plan.json", width=1400, theme="light", height=900):
        media = {"features": [{"name": "prefers-color-scheme", "value": theme}]}
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.get("about:blank")  # else the last page would be drawn anew in this size
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        (tmp_path / "page.html").write_text(page(plan, name)[0], encoding="utf-8")
        browser.get_log("performance")  # what the browser's own first page asks for
        browser.get((tmp_path / "page.html").as_uri())
        wait_for(browser, "return document.documentElement.dataset.drawn === 'yes'")

    yield shown
    wrong = [entry["message"] for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]
    assert wrong == []
    events = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {
        event["params"]["request"]["url"]
        for event in events
        if event["method"] == "Network.requestWillBeSent"
    }
    assert (tmp_path / "page.html").as_uri() in asked, "requests are seen"
    assert {url for url in asked if not url.startswith(("data:", "blob:"))} == {
        (tmp_path / "page.html").as_uri()
    }


def wait_for(browser, question):
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if browser.execute_script(question):
            return
        time.sleep(0.1)
    shown = browser.execute_script("return document.body.innerText")
    raise AssertionError(f"expected {question} of:\n{shown}")


def by(browser, selector):
    from selenium.webdriver.common.by import By

    return browser.find_element(By.CSS_SELECTOR, selector)


def time_shown(browser):
    return float(by(browser, "#now").text.split()[0])


def truth(plan, scenario, when):
    """Positions of all craft by the matrix exponential, m."""
    problem = scenario.problem
    told = zip(scenario.initial, plan.controls, strict=True)
    return [position(s, u, problem.mean_motion, problem.time_step, when) for s, u in told]


PRESS_AT = """
const [sample, done] = arguments, slider = document.getElementById("time");
const look = setInterval(() => {
  if (Number(slider.value) <= sample) return;
  clearInterval(look);
  document.getElementById("play").click();
  done();
}, 5);
"""
"""Presses the button once the slider is past a sample: from outside it could be too late."""


def assert_true_to(browser, plan, scenario, when):
    """Within the half centimetre to which positions are rounded on each axis."""
    wait_for(browser, "return !state.due")  # drawn with the next frame
    found = browser.execute_script(CENTRES, scenario.n)
    np.testing.assert_allclose(found, truth(plan, scenario, when), atol=0.006)


def test_the_slider_and_play_move_thirty_craft_to_where_they_are(browser, opened):
    from selenium.webdriver.common.keys import Keys

    scenario = draw("rings", 0, 30, 0, Problem())
    plan = solve(scenario)
    opened(plan, width=390)  # software draws a small picture in reasonable time
    assert_true_to(browser, plan, scenario, 0.0)
    assert browser.execute_script(RADIUS, 30) == pytest.approx(7.5, abs=1e-6)
    slider = by(browser, "#time")
    for keys in ([Keys.ARROW_RIGHT] * 3, [Keys.PAGE_UP] * 2, [Keys.END]):
        slider.send_keys(*keys)
        times = browser.execute_script("return data.times")
        when = times[int(slider.get_property("value"))]
        assert time_shown(browser) == pytest.approx(when, abs=0.06)
        assert_true_to(browser, plan, scenario, when)
    assert when == 1200.0
    by(browser, "#play").click()
    browser.execute_async_script(PRESS_AT, 3)
    assert 0 < time_shown(browser) < 1200
    assert by(browser, "#play").text == "Play"


def test_the_closest_approach_is_seen_at_its_time_with_its_distance(browser, opened):
    scenario = draw("rings", 0, 10, 0, Problem())
    plan = solve(scenario)
    found = plan.certificate
    i, j = found.min_separation_pair
    opened(plan)
    by(browser, "[data-time]").click()
    wait_for(browser, "return state.sample > 0")
    when = browser.execute_script("return data.times[state.sample]")
    assert when == pytest.approx(found.min_separation_time, abs=1e-3)
    at = truth(plan, scenario, found.min_separation_time)
    apart = np.linalg.norm(at[i] - at[j])
    assert f"closest now {i} and {j}, {apart:.3f} m" in by(browser, "#now").text
    assert_true_to(browser, plan, scenario, when)
    curves = browser.execute_script(
        "return document.getElementById('separation').data.map(({name, x, y}) => [name, x, y])"
    )
    (curve,) = [(x, y) for name, x, y in curves if name == f"{i} and {j}"]
    assert min(curve[1]) == pytest.approx(apart, abs=1e-3)
    assert curve[0][int(np.argmin(curve[1]))] == pytest.approx(when, abs=1e-3)
    assert by(browser, "#marked option:checked").text == f"craft {i} and {j}, the closest"
    shapes = browser.execute_script("return document.getElementById('separation').layout.shapes")
    assert shapes[0]["x0"] == when
    assert [shape["y0"] for shape in shapes[1:]] == [15.0, found.min_separation_bound]
    words = browser.execute_script(
        "return document.getElementById('separation').layout.annotations"
    )
    under = [(15.0, "top"), (found.min_separation_bound, "top")]
    assert [(one["y"], one["yanchor"]) for one in words] == under, "curves pass above"
    tints = [one["font"]["color"] for one in words]
    assert tints == [shape["line"]["color"] for shape in shapes[1:]], "of their lines"


@pytest.mark.parametrize("n", [1, 2])
def test_few_craft_are_shown_on_a_phone_in_the_dark(browser, opened, n):
    scenario = draw("rings", 0, n, 0, Problem())
    plan = solve(scenario)
    opened(plan, width=390, theme="dark", height=600)
    by(browser, "#time").send_keys("\ue010")  # the key End
    assert_true_to(browser, plan, scenario, 1200.0)
    wide, ink, page = browser.execute_script(
        "return [document.documentElement.scrollWidth, "
        "document.getElementById('controls').layout.font.color, "
        "getComputedStyle(document.body).backgroundColor]"
    )
    assert wide == 390
    assert (ink, page) == ("#e8e8e8", "rgb(20, 23, 26)")
    looks = """
        const colours = [], look = () => colours.push(
            document.getElementById("controls").layout.font.color,
            getComputedStyle(document.body).backgroundColor);
        dispatchEvent(new Event("beforeprint")); look();
        dispatchEvent(new Event("afterprint")); look();
        return colours;
    """
    light = ["#1a1a1a", "rgb(255, 255, 255)"]
    assert browser.execute_script(looks) == [*light, ink, page], "printed light"
    printed = """
        dispatchEvent(new Event("beforeprint"));
        const copy = document.getElementById("printed"), wide = [copy.width / 2,
            ...["space", "controls"].map((id) => document.getElementById(id)._fullLayout.width)];
        const seen = copy.getContext("2d").getImageData(0, 0, copy.width, copy.height).data;
        dispatchEvent(new Event("afterprint"));
        const at = Array.from({length: seen.length / 4}, (_, k) => 4 * k);
        return [wide, at.some((k) => seen[k + 3] > 250 && Math.max(...seen.slice(k, k + 3)) < 60)];
    """
    assert browser.execute_script(printed) == [[700] * 3, True], "a sheet's width, in dark ink"
    wait_for(browser, "return find('space')._fullLayout.width < 390")
    hidden = """
        const marked = document.getElementById("marked");
        const edge = (one) => one.getBoundingClientRect();
        scrollBy(0, edge(marked).bottom + 20 - innerHeight);
        marked.focus();
        return edge(marked).bottom - edge(document.querySelector(".transport")).top;
    """
    assert browser.execute_script(hidden) < 0, "what has the focus is above the bar"
    dashes = browser.execute_script(
        "return ['initial', 'goal'].map((end) => getComputedStyle("
        "document.querySelector(`label.${end}`), '::after').borderTopStyle)"
    )
    assert dashes == ["solid", "dashed"]
    assert by(browser, "label.goal").text == "orbits at the goal, dashed"


def test_an_unsafe_plan_with_a_hostile_name_says_so_and_runs_nothing(browser, opened):
    hostile = "</script><script>document.title = 'taken'</script><b onclick='x'>"
    scenario = draw("rings", 0, 10, 3, Problem())
    own = decoupled_optima(scenario.initial, scenario.goal, scenario.problem)
    draft = Draft(own.controls, float(own.lower_bound.sum()))
    plan = certified_plan("decoupled optimum", scenario, draft)
    opened(replace(plan, planner=hostile), hostile, theme="dark")
    assert by(browser, "h1").text == f"Transfer of 10 craft, planned by {hostile}"
    assert browser.title.startswith(hostile)
    top = by(browser, ".verdict").text
    i, j = plan.certificate.min_separation_pair
    assert top.startswith("Unsafe") and f"craft {i} and {j} come within" in top
    titles = browser.execute_script(
        "return [...document.querySelectorAll('.modebar-btn')].map((b) => b.dataset.title)"
    )
    assert titles and not any("hare" in title or "loud" in title for title in titles)


def test_obstacles_drift_and_are_as_large_as_they_are_and_craft_of_one_size_have_one_line(
    browser, opened
):
    problem = Problem()
    drift = (30.0, -80.0, 20.0, 0.0, -60 * problem.mean_motion, 0.01)
    debris = Obstacle("debris", drift, radius=10.0)
    target = Obstacle("target", (0.0,) * 6, semi_axes=(20.0, 60.0, 15.0), hold=True)
    inside = Corridor(Box((-900.0,) * 3, (900.0,) * 3), 0.0, 1200.0)
    bodies = {"craft": (Spacecraft(radius=9.0),) * 3, "obstacles": (target, debris)}
    scenario = replace(draw("rings", 0, 3, 0, problem), **bodies, corridors=(inside,))
    opened(solve(scenario))
    shown = browser.execute_script("return document.getElementById('separation').layout")
    assert shown["shapes"][1]["y0"] == 18.0
    assert shown["annotations"][0]["text"] == "both radii 18 m"
    by(browser, "#time").send_keys("\ue010")  # the key End
    wait_for(browser, "return !state.due")  # drawn with the next frame
    centres = browser.execute_script(CENTRES, 5)
    truth = exact_step(problem.mean_motion, 1200.0)[0][:3] @ np.array(drift)
    assert np.allclose(centres[3], 0, atol=0.02)
    assert np.allclose(centres[4], truth, atol=0.02)
    assert browser.execute_script(RADIUS, 5) == pytest.approx(9.0, abs=0.01)
    lines = browser.execute_script("return document.getElementById('space').data[5].x")
    assert {900.0, -900.0} <= set(lines)


def test_as_in_a_notebook_the_bar_covers_no_motion_and_pairs_of_other_radii_have_other_lines(
    browser, opened
):
    radii = [2.0 + k for k in range(6)]
    craft = tuple(Spacecraft(radius=one) for one in radii)
    scenario = replace(draw("rings", 0, 6, 0, Problem()), craft=craft)
    opened(solve(scenario), width=700, height=HEIGHT)
    edge = "return document.querySelector(arguments[0]).getBoundingClientRect()[arguments[1]]"
    note, bar, below = (
        browser.execute_script(edge, *of)
        for of in ((".look .note", "bottom"), (".transport", "top"), (".transport", "bottom"))
    )
    assert note < bar < below == HEIGHT
    shown = browser.execute_script("return document.getElementById('separation').layout")
    levels = [one["y0"] for one in shown["shapes"] if one["y0"] == one["y1"]]
    pairs = browser.execute_script("return data.pairs")
    assert levels == [radii[i] + radii[j] for i, j in pairs]
    assert [one["text"] for one in shown["annotations"]] == ["dashed: both radii of each pair"]
    least = browser.execute_script("return data.separations.map((all) => Math.min(...all) / 1000)")
    beyond = [apart - level for apart, level in zip(least, levels, strict=True)]
    assert beyond == sorted(beyond)
    rows = by(browser, ".pairs").text.splitlines()[1:]
    said = [float(row.split(" m ")[1]) for row in rows]
    assert said == pytest.approx(least, abs=1e-3)


def test_labels_near_the_bottom_lie_on_no_line(browser, opened):
    far = Ring(craft=1, size=100, offset=4000)
    both = Ring(craft=2, size=150)
    scenario = prolearn.scenario([both, far], [both | {"first_phase_deg": 90}, far])
    opened(solve(replace(scenario, problem=replace(scenario.problem, collision_radius=40.0))))
    for bound in (40.1, 90.0, 300.0):
        browser.execute_script("data.bound = arguments[0]; return draw()", bound)
        spans = browser.execute_script(
            "return ['.annotation-text-g', '.shapelayer path'].map((one) => [...document"
            ".querySelectorAll('#separation ' + one)].map((e) => e.getBoundingClientRect())"
            ".filter((r) => r.width > r.height).map((r) => [r.top, r.bottom]))"
        )
        labels, lines = spans
        assert len(labels) == len(lines) == 2
        for top, bottom in labels:
            assert not any(top + 3 < (a + b) / 2 < bottom - 3 for a, b in lines), bound
