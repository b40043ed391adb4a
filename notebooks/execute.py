"""Executes the notebooks: from text source to pages with outputs.

    python notebooks/execute.py              # all of them, in place
    python notebooks/execute.py 01 06        # those whose names start so

Sources are the `.py` files (jupytext, percent format); the `.ipynb` files are made from them.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import jupytext
import nbclient
import nbformat
from traitlets.config import Config

FOLDER = Path(__file__).resolve().parent
KERNEL = {"display_name": "Python 3", "language": "python", "name": "python3"}
CELL_LIMIT_S = 3600


def sources() -> list[Path]:
    """Text sources of all notebooks, in order."""
    return sorted(FOLDER.glob("[0-9][0-9]_*.py"))


def read(source: Path) -> nbformat.NotebookNode:
    """The notebook of a text source, without outputs; equal texts give equal notebooks."""
    notebook = jupytext.read(source)
    notebook.metadata = nbformat.from_dict(
        {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    )
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number:02d}"
        cell.metadata.clear()
    return notebook


def execute(source: Path, folder: Path | None = None) -> nbformat.NotebookNode:
    """Runs a notebook in a kernel of its own.

    They talk over sockets in the file system where there are such: these need no network, and
    nobody else can listen.

    Args:
      source: Text source.
      folder: Where it runs; that of the source if left out.

    Raises:
      nbclient.exceptions.CellExecutionError: If a cell fails.
    """
    os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"  # XLA remarks on slow compilations
    os.environ["PYTHONWARNINGS"] = "ignore:IProgress not found"  # progress bars without widgets
    notebook = read(source)
    with tempfile.TemporaryDirectory() as sockets:
        # An absolute path: the kernel runs in another folder than this process.
        transport = {"transport": "ipc", "ip": f"{sockets}/kernel"} if os.name == "posix" else {}
        client = nbclient.NotebookClient(
            notebook,
            timeout=CELL_LIMIT_S,
            kernel_name=KERNEL["name"],
            config=Config({"KernelManager": transport}),
            record_timing=False,
            resources={"metadata": {"path": str(folder or source.parent)}},
        )
        client.execute()
    for cell in notebook.cells:
        cell.metadata.clear()
        if cell.cell_type == "code":
            cell.outputs = [output for output in cell.outputs if not _is_empty_page(output)]
    notebook.metadata = read(source).metadata  # the kernel adds its version
    return notebook


def _is_empty_page(output: nbformat.NotebookNode) -> bool:
    """What the line of a run leaves behind."""
    return output.output_type == "display_data" and output.data.get("text/html") == ""


def main(prefixes: list[str]) -> int:
    """Executes the notebooks of these names and writes them beside their sources."""
    chosen = [s for s in sources() if not prefixes or s.name.startswith(tuple(prefixes))]
    if not chosen:
        print(f"there is no notebook {' '.join(prefixes)} in {FOLDER}", file=sys.stderr)
        return 1
    for source in chosen:
        start = time.perf_counter()
        page = source.with_suffix(".ipynb")
        nbformat.write(execute(source), page)
        spent_s = time.perf_counter() - start
        print(f"{page.name}: {page.stat().st_size / 1000:.0f} kB, {spent_s:.0f} s", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
