"""What builds and publishes: workflows, the container file, and the lock of versions."""

import itertools
import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


def read_targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflows_do_what_there_is(path):
    text = path.read_text(encoding="utf-8")
    workflow = yaml.safe_load(text)
    assert workflow["permissions"] == {"contents": "read"}, "a job asks for more by itself"
    for name, job in workflow["jobs"].items():
        assert "runs-on" in job, name
        for step in job["steps"]:
            assert ("uses" in step) != ("run" in step), (name, step)
            assert "@" in step.get("uses", "@")
        needed = job.get("needs", [])
        assert {needed} if isinstance(needed, str) else set(needed) <= set(workflow["jobs"])
    assert set(re.findall(r"\bmake ([a-z-]+)", text)) <= read_targets()


def test_the_container_copies_what_there_is():
    lines = (ROOT / "Dockerfile").read_text().splitlines()
    stages: list[str] = []
    for line in lines:
        if match := re.match(r"FROM (\S+) AS (\w+)$", line):
            assert match[1] in stages or re.match(r"[\w-]+:[\w.-]+$", match[1])
            stages.append(match[2])
        elif match := re.match(r"COPY --from=(\w+)", line):
            assert match[1] in stages
        elif line.startswith("COPY "):
            *sources, _ = line.split()[1:]
            let_in = (ROOT / ".dockerignore").read_text().splitlines()
            for source in sources:
                assert (ROOT / source).exists()
                assert f"!{source}" in let_in
    assert stages == ["wheel", "core", "cuda"]


def test_the_lock_is_of_this_project():
    lock = tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))
    (own,) = (package for package in lock["package"] if package["name"] == PROJECT["name"])
    extras = itertools.chain.from_iterable(PROJECT["optional-dependencies"].values())
    wanted = [*PROJECT["dependencies"], *extras]
    stated = {re.sub(r"\s", "", text.lower()) for text in wanted}
    locked = {one["name"] + one.get("specifier", "") for one in own["metadata"]["requires-dist"]}

    def in_parts(texts: set[str]) -> set[tuple[str, frozenset[str]]]:
        parts = (re.match(r"([\w.-]+?)((?:[<>=!~].*)?)$", text) for text in texts)
        return {(p[1], frozenset(filter(None, p[2].split(",")))) for p in parts if p}

    assert in_parts(locked) == in_parts(stated), "run: uv lock"
    sources = {source for one in lock["package"] for source in one["source"].values()}
    assert sources <= {"https://pypi.org/simple", "."}
