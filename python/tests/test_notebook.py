"""The notebook that compares with VQF runs, and is committed without outputs.

APLOMB_RECORDING, if it is set, names its recording; APLOMB_OUTPUT a folder for the executed one.
"""

import base64
import os
import pathlib
import re

import pytest

NOTEBOOK = pathlib.Path(__file__).parents[1] / "compare_vqf.ipynb"


@pytest.fixture
def notebook():
    nbformat = pytest.importorskip("nbformat", reason="nbformat is not installed")
    return nbformat.read(NOTEBOOK, as_version=4)


def test_it_is_committed_without_outputs(notebook):
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    longest = max(cell.source.count("\n") + 1 for cell in code)
    assert longest <= 10, "it compares in ten lines"


def test_it_runs_and_draws(notebook):
    for package in ("nbclient", "ipykernel", "matplotlib", "vqf"):
        pytest.importorskip(package, reason=f"{package} is not installed")
    import nbclient

    nbclient.NotebookClient(notebook, timeout=300).execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    text = "".join(output.get("text", "") for output in outputs)
    ours, theirs = map(float, re.search(r"aplomb (\S+) VQF (\S+)", text).groups())
    data = [output.get("data", {}) for output in outputs]
    pictures = [values["image/png"] for values in data if "image/png" in values]
    picture = base64.b64decode(pictures[0])
    assert len(pictures) == 1 and picture.startswith(b"\x89PNG") and len(picture) > 10_000
    assert 0.05 < ours < theirs < 30, "aplomb is the better one on the default recordings"
    folder = os.environ.get("APLOMB_OUTPUT")
    if folder:
        pathlib.Path(folder, "compare_vqf.png").write_bytes(picture)
    print(f"notebook: aplomb {ours}, VQF {theirs} degrees")
