"""The MLflow UI on a store of ours, in a real browser."""

import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from forked import Forked
from tracking import serve

from cli.jobs.experiments import evaluate
from cli.jobs.train import train_model
from cli.settings import Evaluation, TrainingSettings
from pipeline.parallel.workers import Workers
from registry.models import list_versions

CHROMIUM, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
ARCHITECTURES = ("ff1", "ff2", "ffcol", "lstm1", "lstm2", "lstmcol")
COMPARED = ("exp1_flown_collisions", "exp1_flown_fuel", "exp1_flown_seconds", "best_valid_loss")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    "--window-size=2600,1400",  # wide enough for six columns beside the panels
)
PATIENCE = 120  # s

pytestmark = [
    pytest.mark.system,
    pytest.mark.skipif(
        not (CHROMIUM and DRIVER), reason="needs Debian's packages chromium and chromium-driver"
    ),
]


@pytest.fixture
def six(folder: Path, solved: Path) -> Path:
    """A store with a run of each architecture, trained for an epoch and evaluated."""
    for arch in ARCHITECTURES:
        how = TrainingSettings(data=str(solved), n=3, epochs=1, device="cpu")
        train_model(arch, 0, how)
    evaluate(Evaluation(data=str(solved), sizes="3", trials=1, timed=1), workers=Workers(1))
    return folder


@pytest.fixture
def address(six: Path, free_port: int, forked: Forked) -> Iterator[str]:
    """``mlflow ui`` on loopback."""
    with serve(forked, six, free_port, "ui"):
        yield f"http://127.0.0.1:{free_port}"


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path / 'profile'}"):
        options.add_argument(flag)
    started = webdriver.Chrome(options=options, service=Service(DRIVER))
    try:
        yield started
    finally:
        started.quit()


def text_with(browser: Any, *wanted: str) -> str:
    """The page's text, as soon as all of some words are in it."""
    deadline = time.monotonic() + PATIENCE
    shown = ""
    while time.monotonic() < deadline:
        shown = browser.execute_script("return document.body.innerText")
        if all(word in shown for word in wanted):
            return shown
        time.sleep(0.2)
    raise AssertionError(f"expected {wanted} in:\n{shown}")


def test_six_runs_are_marked_in_the_table_and_compared_side_by_side(
    address: str, browser: Any
) -> None:
    from selenium.webdriver.common.by import By

    versions = {version.arch: version for version in list_versions()}
    names = [f"{arch}-tuned-seed0" for arch in ARCHITECTURES]

    browser.get(f"{address}/#/experiments/1/runs")
    text_with(browser, *names, "6 matching runs")
    browser.find_element(By.CSS_SELECTOR, "[aria-label='Select all runs']").click()
    text_with(browser, "Compare")
    (compare,) = [b for b in browser.find_elements(By.TAG_NAME, "button") if b.text == "Compare"]
    compare.click()

    # numbers as the page writes them: three places, trailing zeros left out
    numbers = {
        f"{version.metrics[name]:.3f}".rstrip("0")
        for version in versions.values()
        for name in ("best_valid_loss", "exp1_flown_fuel_ratio")
    }
    text_with(browser, "Comparing 6 Runs", "Parameters", *names, *COMPARED, *numbers)
