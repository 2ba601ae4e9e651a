"""The page of a plan: one HTML file that opens offline."""

import base64
import gzip
import hashlib
from functools import cache
from pathlib import Path

from jinja2.utils import htmlsafe_json_dumps

from pipeline.markup import template
from pipeline.plan.plan import Plan
from pipeline.plan.recheck import Rechecked, recheck
from pipeline.show.data import LARGER, page_data, steps_of
from pipeline.show.tables import certificate_rows, motion, planner_rows, scenario_rows, verdict

HERE = Path(__file__).parent


def page(claimed: Plan, name: str) -> tuple[str, Rechecked]:
    """A plan's page, which needs nothing outside itself, and the rechecked plan that it shows."""
    shown, scenario = recheck(claimed), claimed.scenario
    data, pairs = page_data(shown.plan)
    found = shown.plan.certificate
    by_kind = found.craft_delta_v, found.craft_delta_v_2norm, found.craft_delta_v_thrusters
    script = (HERE / "page.js").read_text(encoding="utf-8")
    plotly, plotly_hash = _plotly()
    text = template("pipeline/show/page.html.jinja").render(
        name=name,
        planner=claimed.planner,
        scenario=scenario,
        verdict=verdict(shown, claimed.status),
        certificate=certificate_rows(shown.plan, claimed.status),
        setting=scenario_rows(scenario),
        thrusters=bool(found.craft_delta_v_thrusters),
        spent=list(zip(*filter(None, by_kind), strict=True)),
        planning=planner_rows(shown.plan, claimed.status),
        pairs=pairs,
        ends={"initial": "start", "goal": "goal"},
        drawn=[end for end, orbits in data["orbits"].items() if orbits],
        larger=LARGER,
        least=min(data["radii"]),
        spacing=scenario.problem.time_step / steps_of(scenario.n, scenario.problem),
        motion=motion(shown.plan),
        hashes=[_hash(script.encode()), plotly_hash],
        data=htmlsafe_json_dumps(data, separators=(",", ":"), allow_nan=False),
        script=script,
        plotly=plotly,
        licence=(HERE / "vendor" / "LICENSE").read_text(encoding="utf-8"),
    )
    return text, shown


@cache
def _plotly() -> tuple[str, str]:
    """The JavaScript plotting library, compressed and in base64, and its hash."""
    script = (HERE / "vendor" / "plotly-gl3d.min.js").read_bytes()
    return base64.b64encode(gzip.compress(script, mtime=0)).decode(), _hash(script)


def _hash(script: bytes) -> str:
    """The hash by which a content security policy allows a script."""
    return "sha256-" + base64.b64encode(hashlib.sha256(script).digest()).decode()
