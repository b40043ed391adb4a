"""What the README shows works as it stands there."""

import ast
import re
import shlex
from pathlib import Path

import pytest

import remind_jax
from remind_jax.cli import main as main_module
from remind_jax.cli.main import VERBS

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.parametrize("block", blocks("python"), ids=["run", "live", "pure"])
def test_python_blocks_use_names_that_exist(block):
    for node in ast.walk(ast.parse(block)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            assert node.value.id != "rj" or hasattr(remind_jax, node.attr)


@pytest.mark.slow
def test_robot_loop_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks("python")[1], "README.md", "exec"), {})
    assert (tmp_path / "memory.safetensors").exists()


def remind_commands() -> list[str]:
    lines = "\n".join(blocks("bash")).splitlines()
    return [line for line in lines if line.startswith("remind ")]


@pytest.mark.parametrize("line", remind_commands())
def test_commands_can_be_parsed(line):
    main_module._parse(shlex.split(line, comments=True)[1:])


def test_every_verb_is_in_the_table():
    shown = re.findall(r"^\| `remind (\w+)", README, flags=re.MULTILINE)
    assert shown == list(VERBS)
