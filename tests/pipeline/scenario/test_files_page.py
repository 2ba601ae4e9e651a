"""docs/files.md: its scenario is one, and its tables name every field there is."""

import json
import re
from dataclasses import fields
from pathlib import Path

from pipeline.documents import document_from
from pipeline.expert import solve
from pipeline.orbit.covariance import Uncertainty
from pipeline.plan.certificate import Certificate, Clearance, Risk
from pipeline.plan.document import PlanDocument
from pipeline.scenario import diagnostics
from pipeline.scenario.document import ScenarioDocument
from pipeline.scenario.part_documents import ObstacleDocument, ReferenceDocument, RingDocument

PAGE = (Path(__file__).parents[3] / "docs" / "files.md").read_text(encoding="utf-8")


def test_the_scenario_on_the_page_is_fine_and_can_be_planned():
    shown = json.loads(re.search(r"```json\n(.*?)```", PAGE, re.DOTALL)[1])
    scenario = document_from(shown, ScenarioDocument).scenario("shown")
    assert [one.text for one in diagnostics(scenario) if not one.fine] == []
    assert solve(scenario).status == "solved"
    assert scenario.reference is not None


def test_every_field_has_its_row():
    shown = set(re.findall(r"`(\w+)`", PAGE))
    for model in (
        ScenarioDocument,
        RingDocument,
        ReferenceDocument,
        ObstacleDocument,
        PlanDocument,
    ):
        assert {field.alias or name for name, field in model.model_fields.items()} <= shown
    for value in (Certificate, Clearance, Risk, Uncertainty):
        assert {field.name for field in fields(value)} <= shown


def test_the_scenario_with_obstacles_on_the_page_keeps_clear_of_them():
    shown = [json.loads(one) for one in re.findall(r"```json\n(\{.*?)```", PAGE, re.DOTALL)]
    (given,) = (one for one in shown if "obstacles" in one)
    corridors = re.search(r'```json\n"corridors": (.*?)```', PAGE, re.DOTALL)
    assert corridors is not None
    given["corridors"] = json.loads(corridors[1])
    given["corridors"][1] |= {"to": 900}  # the goals are behind the target
    given["corridors"][0]["box"]["max"][1] = 300
    plan = solve(document_from(given, ScenarioDocument).scenario("shown"))
    assert plan.status == "solved", plan.message
    assert plan.certificate.clearance is not None
