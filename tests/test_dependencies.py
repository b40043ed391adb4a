"""Nothing is installed that nothing uses, and nothing is used that is not installed."""

import ast
import re
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FOR_USERS = (
    "detect",
    "hub",
    "viz",
    "viewers",
    "sweep",
    "cluster",
    "convert",
)  # extras; others are for developers

# Distributions whose modules are called otherwise.
MODULES = {
    "foxglove-sdk": "foxglove",
    "ipython": "IPython",
    "mcap-protobuf-support": "mcap_protobuf",
    "opencv-python-headless": "cv2",
    "pillow": "PIL",
    "pytest-xdist": "xdist",
    "pyyaml": "yaml",
}
# What is used without being imported by us: where, and by which word.
TOOLS = {
    "build": ("Makefile", "-m build"),
    "hatchling": ("pyproject.toml", "hatchling.build"),
    "import-linter": ("Makefile", "lint-imports"),
    "ipykernel": ("tests/notebooks/test_notebooks.py", "ipykernel"),
    "mkdocs-material": ("docs/site/mkdocs.yml", "material"),
    "pre-commit": (".pre-commit-config.yaml", "pre-commit"),
    "pyright": ("Makefile", "pyright"),
    "ruff": ("Makefile", "ruff"),
    "twine": ("Makefile", "twine check"),
}

# What is imported without being declared, and why.
UNDECLARED = {
    "boxmot": "a tracker of others, in an environment of its own (benchmarks/field_peers)",
    "IPython": "progress in a notebook, which brings it",
    "norfair": "a tracker of others, in an environment of its own (benchmarks/field_peers)",
    "pandas": "`Result.to_dataframe`, for those who have it",
    "PIL": "writes what the reference of a metric reads, where that is installed",
    "trackeval": "the reference of the metrics, on no package index",
    "trackers": "trackers of others, in an environment of their own (benchmarks/field_peers)",
    "ultralytics": "trackers of others, in an environment of their own (benchmarks/field_peers)",
    "transformers": "the reference of the networks, larger than all the rest",
}
OURS = {"remind_jax", "remind_ros", "weights_convert", "tests", "benchmarks", "notebooks"}
# Modules of the original tracker, which benchmarks import from where it was downloaded.
ORIGINAL = {"config", "detection", "features", "memory", "pipeline"}


def names(requirements: list[str]) -> list[str]:
    return [re.split(r"[<>=!~\[; ]", requirement)[0] for requirement in requirements]


def imported(*folders: str) -> set[str]:
    """Every top module that a file in one of the folders imports."""
    paths = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    return set().union(*map(imported_by, paths))


@cache
def imported_by(path: Path) -> frozenset[str]:
    """Every top module that a file imports, inside functions too."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return frozenset(found)


def module_of(name: str) -> str:
    return MODULES.get(name, name.replace("-", "_"))


def is_used(name: str, *folders: str) -> bool:
    if name in TOOLS:
        file, word = TOOLS[name]
        return word in (ROOT / file).read_text(encoding="utf-8")
    return module_of(name) in imported(*folders)


@pytest.mark.parametrize("name", names(PROJECT["dependencies"]))
def test_the_package_imports_what_it_depends_on(name):
    assert is_used(name, "remind_jax", "weights_convert")


@pytest.mark.parametrize("extra", PROJECT["optional-dependencies"])
def test_every_part_of_an_extra_is_used(extra):
    folders = ["remind_jax", "weights_convert"]
    if extra not in FOR_USERS:
        folders += ["tests", "notebooks", "benchmarks", "docs"]
    for name in names(PROJECT["optional-dependencies"][extra]):
        assert is_used(name, *folders), name


@pytest.mark.parametrize(
    ("folders", "extras"),
    [
        (("remind_jax", "weights_convert"), FOR_USERS),
        (("tests", "benchmarks", "notebooks", "docs"), PROJECT["optional-dependencies"]),
    ],
    ids=["package", "rest"],
)
def test_what_is_imported_is_declared(folders, extras):
    declared = set(names(PROJECT["dependencies"]))
    declared.update(*(names(PROJECT["optional-dependencies"][extra]) for extra in extras))
    known = {*map(module_of, declared), *UNDECLARED, *sys.stdlib_module_names} | OURS | ORIGINAL
    assert sorted(imported(*folders) - known) == []


def test_what_is_excused_is_imported():
    everywhere = imported("remind_jax", "weights_convert", "tests", "benchmarks", "notebooks")
    assert set(UNDECLARED) | ORIGINAL <= everywhere


def test_every_extra_that_a_message_names_exists():
    sources = [
        path for top in ("remind_jax", "weights_convert") for path in ROOT.glob(f"{top}/**/*.py")
    ]
    text = "".join(path.read_text(encoding="utf-8") for path in sources)
    named = {
        extra for group in re.findall(r"remind-jax\[([\w,]+)\]", text) for extra in group.split(",")
    }
    assert named <= set(FOR_USERS)
