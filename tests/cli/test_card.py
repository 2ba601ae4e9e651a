"""prolearn dataset card as a person runs it, and prolearn dataset beside it."""

import yaml


def made(run, *options):
    for command in (
        ["sample", "--n", 2, "--count", 4, "--out", "data", *options],
        ["solve", "data"],
    ):
        assert run(*command, "--jobs", 1).returncode == 0


def test_the_card_is_written_and_the_dataset_stays_sound(run, tmp_path):
    made(run)
    done = run("dataset", "card", "data", "--license", "cc-by-4.0")
    assert done.returncode == 0
    assert done.stdout == "README.md is in data; it describes 4 scenarios.\n"
    text = (tmp_path / "data/README.md").read_text(encoding="utf-8")
    assert yaml.safe_load(text.split("---\n")[1])["license"] == "cc-by-4.0"
    done = run("verify", "data", "--jobs", 1)
    assert (done.returncode, done.stdout) == (0, "data is sound: 4 rows.\n")


def test_a_readme_of_one_s_own_is_status_2_and_stays(run, tmp_path):
    made(run)
    (tmp_path / "data/README.md").write_text("mine")
    done = run("dataset", "card", "data")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.splitlines()[-1].startswith("prolearn: data has a README.md")
    assert (tmp_path / "data/README.md").read_text() == "mine"
    assert run("dataset", "card", "data", "--force").returncode == 0
    assert (tmp_path / "data/README.md").read_text() != "mine"


def test_a_folder_without_a_dataset_is_status_2(run):
    done = run("dataset", "card", "nowhere")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("prolearn: nowhere does not exist; expected a dataset folder")


def test_a_preset_still_takes_its_options(run):
    made(run, "--shares", "0,0,1")
    done = run("dataset", "--preset", "demo", "--out", "data", "--jobs", 1)
    assert (done.returncode, done.stdout) == (2, "")
    assert "data at n=2 was begun with count = 4, now it is 20" in done.stderr


def test_options_of_a_preset_are_refused_before_card(run):
    done = run("dataset", "--out", "data", "card", "data")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("prolearn: --out is of `prolearn dataset` alone")
    done = run("dataset", "data/paper")
    assert done.returncode == 2
    assert "No such command 'data/paper'" in done.stderr
