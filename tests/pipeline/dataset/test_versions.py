"""What other versions have made is neither taken for done nor mixed with what these make."""

import json
import shutil

import pyarrow.parquet as pq
import pytest
from contents import content
from forged import forge, remove

from pipeline.dataset.making import SOLVED_BY, sample, solve
from pipeline.dataset.manifest import read_manifest
from pipeline.dataset.samples import Sample
from pipeline.dataset.verifying import repair
from pipeline.errors import InputError, ProlearnError
from pipeline.expert import Settings
from pipeline.orbit.problem import Problem
from pipeline.parallel.workers import Workers, check_worker
from pipeline.provenance import code_digest, made_with
from pipeline.storage.shards import METADATA_KEY, encode

ONE = Workers(jobs=1)
SAMPLES = {2: Sample(count=7, shard_rows=3)}


def made_by(folder, stage, **versions):
    """Let a dataset say that it was made with other versions."""
    forge(folder, lambda manifest: manifest["made_with"][stage].update(versions))


RUNS = {
    "sample": lambda folder: sample(
        folder, {4: Sample(count=2)}, Problem(), workers=Workers(jobs=1)
    ),
    "solve": lambda folder: solve(folder, Settings(), workers=ONE),
    "repair": lambda folder: repair(folder, workers=ONE),
}


@pytest.mark.parametrize("run", RUNS)
def test_scenarios_of_another_version_are_refused_by_name_with_both_versions(solved, run):
    made_by(solved, "sample", numpy="1.0")
    before = content(solved)
    with pytest.raises(InputError, match=r"was sampled with numpy 1\.0, now it is 2"):
        RUNS[run](solved)
    assert content(solved) == before


@pytest.mark.parametrize("run", ["solve", "repair"])
@pytest.mark.parametrize(
    ("versions", "said"),
    [
        ({"clarabel": "0.1.2"}, r"was solved with clarabel 0\.1\.2, now it is "),
        ({"prolearn": "0.1.0+code.0"}, r"with prolearn 0\.1\.0\+code\.0, now it is 0.*remove this"),
    ],
    ids=["solver", "code"],
)
def test_plans_of_another_version_are_refused_by_name(solved, run, versions, said):
    made_by(solved, "solve", **versions)
    (solved / "n=2/part-00000.parquet").unlink()
    before = content(solved)
    with pytest.raises(InputError, match=said):
        RUNS[run](solved)
    assert content(solved) == before


def test_a_folder_of_an_older_layout_is_refused_with_what_to_do(solved):
    forge(solved, lambda manifest: manifest.update(schema="prolearn.dataset/1"))
    with pytest.raises(InputError, match=r"schema prolearn\.dataset/1.*make the dataset anew"):
        read_manifest(solved)


def test_plans_of_another_version_are_not_adopted_where_the_manifest_is_gone(solved):
    name = "n=2/part-00000.parquet"
    right = (solved / name).read_bytes()
    table = pq.read_table(solved / name, partitioning=None)
    about = json.loads(table.schema.metadata[METADATA_KEY])
    about["made_with"]["clarabel"] = "0.1.2"
    old = table.replace_schema_metadata({METADATA_KEY: json.dumps(about, sort_keys=True)})
    (solved / name).write_bytes(encode(old))
    shutil.rmtree(solved / "n=3")
    remove(solved)
    sample(solved, SAMPLES, Problem(), workers=ONE)
    solve(solved, Settings(), workers=ONE)
    assert (solved / name).read_bytes() == right


def test_a_worker_with_other_versions_is_refused():
    here = SOLVED_BY
    check_worker(made_with(*here), here)
    with pytest.raises(ProlearnError, match=r"numpy 1\.0, now it is 2.* on all machines"):
        check_worker({**made_with(*here), "numpy": "1.0"}, here)


def test_the_code_is_known_by_its_source_files_and_their_names(tmp_path):
    for part in ("orbit", "plan"):
        (tmp_path / part).mkdir()
        (tmp_path / part / "a.py").write_text("x = 1\n")
    first, other = (code_digest((part,), tmp_path) for part in ("orbit", "plan"))
    (tmp_path / "plan" / "a.py").write_text("x = 2\n")
    assert code_digest(("orbit",), tmp_path) == first
    assert code_digest(("plan",), tmp_path) != other
    (tmp_path / "orbit" / "a.py").rename(tmp_path / "orbit" / "b.py")
    assert code_digest(("orbit",), tmp_path) != first


def test_what_others_bring_is_known_by_its_version_and_the_code_of_its_module(
    tmp_path, monkeypatch
):
    (tmp_path / "theirs" / "parts").mkdir(parents=True)
    (tmp_path / "theirs" / "__init__.py").write_text("raise SystemExit('it is imported')")
    (tmp_path / "theirs" / "template.py").write_text("{{ no Python }}")
    (tmp_path / "their_networks.dist-info").mkdir()
    monkeypatch.syspath_prepend(tmp_path)

    def made(source, version="1.0"):
        metadata = f"Name: their-networks\nVersion: {version}\n"
        (tmp_path / "their_networks.dist-info" / "METADATA").write_text(metadata)
        (tmp_path / "theirs" / "parts" / "layers.py").write_text(source)
        made_with.cache_clear()
        return made_with(("pipeline/orbit",), ("numpy", "their-networks:theirs"))

    first = made("x = 1")
    theirs = first["their-networks:theirs"]
    assert theirs.startswith("1.0+code.")
    ours = made_with(("pipeline/orbit",), ("numpy",))
    assert first == {**ours, "their-networks:theirs": theirs}
    assert made("x = 1  # one") == first
    assert made("x = 1", version="1.1")["their-networks:theirs"] == theirs.replace("1.0", "1.1", 1)
    assert made("x = 2")["their-networks:theirs"] != theirs


def test_a_worker_without_what_others_bring_is_refused():
    theirs = {"prolearn": "0.3", "their-networks:theirs": "1.0+code.0"}
    with pytest.raises(ProlearnError, match=r"their-networks, which is not installed on a worker"):
        check_worker(theirs, ((), ("their-networks:theirs",)))


WRITTEN = '''"""A module."""

def twice(x: float) -> float:
    """Two times x."""
    return 2 * x  # exactly

class Empty:
    """Nothing."""
'''

SAME = (
    WRITTEN.replace("A module", "Another text"),
    WRITTEN.replace("  # exactly", ""),
    WRITTEN.replace("2 * x", "(2\n            * x)"),
    WRITTEN.replace('    """Two times x."""\n', ""),
)
OTHER = (
    WRITTEN.replace("2 * x", "x * 2"),
    WRITTEN.replace("2 * x", "2.0 * x"),
    WRITTEN.replace("return 2 * x", 'return f"{x}"'),
    WRITTEN.replace("twice", "Twice"),
    WRITTEN.replace("x: float", "x: float = None"),
    WRITTEN.replace("x: float", "*, x, y=None"),
    WRITTEN.replace("x: float", "*, x=None, y"),
    WRITTEN.replace('"""Nothing."""', 'what = """Nothing."""'),
)


def test_the_code_is_known_by_what_it_does_and_not_by_what_is_said_of_it(tmp_path):
    def digest(source):
        (tmp_path / "a.py").write_text(source)
        return code_digest(("a.py",), tmp_path)

    assert {digest(source) for source in (WRITTEN, *SAME)} == {digest(WRITTEN)}
    assert len({digest(source) for source in (WRITTEN, *OTHER)}) == 1 + len(OTHER)


def test_code_that_decides_a_result_is_named_by_folders_modules_and_patterns(tmp_path):
    for part in ("first", "second"):
        (tmp_path / "experiments" / part).mkdir(parents=True)
        for name in ("run", "figure"):
            (tmp_path / "experiments" / part / f"{name}.py").write_text("x = 1\n")
    runs = code_digest(("experiments/*/run.py",), tmp_path)
    (tmp_path / "experiments" / "first" / "figure.py").write_text("x = 2\n")
    assert code_digest(("experiments/*/run.py",), tmp_path) == runs
    (tmp_path / "experiments" / "second" / "run.py").write_text("x = 2\n")
    assert code_digest(("experiments/*/run.py",), tmp_path) != runs
    one, folder = ("experiments/first/run.py",), ("experiments/first",)
    assert code_digest((*folder, *one), tmp_path) == code_digest(folder, tmp_path)
    assert code_digest(one, tmp_path) != code_digest(folder, tmp_path)
