"""Every module that reads a file is in the table of what guards it."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "file_formats.md"
ROW = re.compile(r"^\|.*$", re.MULTILINE)
MODULE = re.compile(r"`((?:remind_jax|weights_convert)/[\w/]+\.py)`")

# Functions and methods that read what somebody else wrote.
READING = {
    *("read_bytes", "read_text", "read_json", "read_lines", "read_yaml"),
    *("decode_json", "decode_rows", "read_npz", "read_safetensors_header", "safe_open"),
    "read_safetensors_parts",
    *("load_file", "loads", "load", "loadtxt", "fromfile", "memmap", "imread", "InferenceSession"),
    *("open_tar", "ZipFile", "check"),
}
# Modules that read only what belongs to this package or to the system, or hand reading on.
OUR_OWN = {
    "remind_jax/backbone/patch_statistics.py": "what light changes, beside it",
    "remind_jax/benchmark/running.py": "the memory of the process, in /proc",
    "remind_jax/benchmark/scenes.py": "the digest of a scene",
    "remind_jax/benchmark/tours.py": "the digest of what it rendered itself",
    "remind_jax/compiled/method_code.py": "the source of a tracker that runs already, for a digest",
    "remind_jax/compiled/programs.py": "the source of this package",
    "remind_jax/live_page/server.py": "the page that it serves",
    "remind_jax/outputs/overlay.py": "whether its own video can be played",
    "remind_jax/session/machine_memory.py": "the memory of the system, in /sys",
    "weights_convert/variant_detection.py": "values of a configuration that was read already",
}


def reads(path: Path) -> bool:
    """Whether a module calls a function that reads a file."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name == "open":
            modes = [a.value for a in (*node.args, *(k.value for k in node.keywords))
                     if isinstance(a, ast.Constant)]  # fmt: skip
            is_video = ast.unparse(node.func) == "av.open" and "w" not in modes
            if "rb" in modes or is_video or isinstance(node.func, ast.Name):
                return True
        if name == "check" and not isinstance(node.func, ast.Name):
            continue  # a method of that name
        if name == "load" and ast.unparse(node.func) != "np.load":
            continue
        if name in READING:
            return True
    return False


def readers() -> set[str]:
    """Every module that reads, but those of the border itself."""
    modules = (p for top in ("remind_jax", "weights_convert") for p in (ROOT / top).rglob("*.py"))
    found = {path.relative_to(ROOT).as_posix() for path in modules if reads(path)}
    return {name for name in found if not name.startswith("remind_jax/files/")}


def test_every_reader_is_in_the_table():
    page = PAGE.read_text(encoding="utf-8").partition("## What guards each file")[2]
    named = {name for row in ROW.findall(page) for name in MODULE.findall(row)}
    assert readers() - set(OUR_OWN) == named


def test_what_is_excused_reads():
    assert set(OUR_OWN) <= readers()
