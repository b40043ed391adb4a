"""The notebooks: text and page are in step, pages are executed and small, sources run.

The sources run here as plain scripts, with little optimisation and the programs that other tests
compiled; `make notebooks` executes them as users do and writes the pages anew.
"""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import jax
import pytest

WHY = "needs the extra 'notebooks': pip install -e '.[notebooks]'"
nbformat = pytest.importorskip("nbformat", reason=WHY)
pytest.importorskip("jupytext", reason=WHY)
pytest.importorskip("nbclient", reason=WHY)
pytest.importorskip("ipykernel", reason=WHY)

FOLDER = Path(__file__).resolve().parents[2] / "notebooks"
SOURCES = sorted(FOLDER.glob("[0-9][0-9]_*.py"))
QUICK = ("01",)  # always run; the others when slow tests are

MAX_BYTES, MAX_BYTES_IN_ALL = 400_000, 2_000_000


def load_executor():
    """The script `notebooks/execute.py`."""
    spec = importlib.util.spec_from_file_location("execute_notebooks", FOLDER / "execute.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


executor = load_executor()


def of_each(*, quick: bool):
    """Parametrises a test by those sources that are executed always, or by the others."""
    chosen = [source for source in SOURCES if source.name.startswith(QUICK) == quick]
    return pytest.mark.parametrize("source", chosen, ids=lambda source: source.stem)


every_page = pytest.mark.parametrize("source", SOURCES, ids=lambda source: source.stem)


def read_page(source: Path):
    return nbformat.read(source.with_suffix(".ipynb"), as_version=4)


def test_all_notebooks_are_there():
    assert [source.name[:2] for source in SOURCES] == ["01", "02", "03", "04", "05", "06", "07"]
    assert executor.sources() == SOURCES
    pages = {page.stem for page in FOLDER.glob("*.ipynb")}
    assert pages == {source.stem for source in SOURCES}


@every_page
def test_page_is_made_from_its_source(source):
    """`make notebooks` brings them in step again."""
    ours, page = executor.read(source), read_page(source)
    assert [(cell.cell_type, cell.source) for cell in page.cells] == [
        (cell.cell_type, cell.source) for cell in ours.cells
    ]
    assert page.metadata == ours.metadata


@every_page
def test_page_was_executed_without_errors(source):
    cells = [cell for cell in read_page(source).cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in cells] == list(range(1, len(cells) + 1))
    outputs = [output for cell in cells for output in cell.outputs]
    assert any("data" in output for output in outputs)
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]


@every_page
def test_page_tells_what_one_learns_and_takes_away(source):
    first, last = read_page(source).cells[0], read_page(source).cells[-1]
    assert first.source.startswith(f"# {source.name[:2]} ")
    assert "learn" in first.source
    assert "**Take-away.**" in last.source


@every_page
def test_links_lead_to_files(source):
    for cell in read_page(source).cells:
        for word in cell.source.replace(")", " ").replace("(", " ").split():
            if word.startswith("../"):
                assert (FOLDER / word).is_file(), word


def test_pages_are_small():
    sizes = {page.name: page.stat().st_size for page in FOLDER.glob("*.ipynb")}
    assert max(sizes.values()) <= MAX_BYTES, sizes
    assert sum(sizes.values()) <= MAX_BYTES_IN_ALL, sizes


def run_source(source: Path) -> None:
    """Runs a notebook as a script that finds the programs that the tests compiled."""
    settings = {
        "JAX_PLATFORMS": os.environ.get("JAX_PLATFORMS", "cpu"),
        "JAX_DISABLE_MOST_OPTIMIZATIONS": "1",
        "JAX_COMPILATION_CACHE_DIR": str(jax.config.values["jax_compilation_cache_dir"]),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.3",
        "MPLBACKEND": "Agg",
    }
    done = subprocess.run(
        [sys.executable, source.name],
        cwd=FOLDER,
        env=os.environ | settings,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr[-3000:]


@pytest.mark.slow
@of_each(quick=True)
def test_source_runs(source):
    run_source(source)


@pytest.mark.slow
@of_each(quick=False)
def test_long_source_runs(source):
    run_source(source)
