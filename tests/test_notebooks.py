"""Each notebook runs from start to end, is kept without outputs, and says what it needs."""

import json
import re
import tomllib
from pathlib import Path

import nbformat
import pytest
from jupyter_client import AsyncKernelManager
from jupyter_client.kernelspec import KernelSpecManager
from nbclient import NotebookClient
from nbformat.v4 import new_code_cell, new_notebook

ROOT = Path(__file__).parents[1]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
PATIENCE = {"timeout": None, "startup_timeout": 3600, "iopub_timeout": 3600}
"""A busy machine may take its time: to start, for a cell that compiles, and to print."""
SHORTER = {
    "01_quickstart": {"range(20)": "range(2)", "planner, range(3)": "planner, range(2)"},
    "02_sensor_and_map": {
        "np.zeros((1000, 64))": "np.zeros((50, 64))",
        "sequence in range(1000)": "sequence in range(50)",
        "seeds=range(20)": "seeds=range(2)",
        "run_killian()": "run_killian(stride=6)",
    },
    "03_rating_function": {
        "policy, range(40)": "policy, range(2)",
        "in range(500)": "in range(20)",
        "policy, range(20)": "policy, range(2)",
    },
    "04_train_and_compare": {
        "total_steps=6144, segment_steps=2048": "total_steps=1024, segment_steps=512",
        "validation_episodes=20": "validation_episodes=2",
        "policy, range(30)": "policy, range(2)",
        "policies[name], range(10)": "policies[name], range(2)",
    },
}
"""Numbers of worlds, draws and steps that tests replace: every cell runs, with wider intervals."""

each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_the_first_notebook_is_the_quickstart():
    assert NOTEBOOKS[0].name == "01_quickstart.ipynb"


def read_shortened(path):
    """A notebook with the smaller numbers of `SHORTER`, each of which replaces exactly one."""
    notebook = nbformat.read(path, as_version=4)
    for long, short in SHORTER[path.stem].items():
        (cell,) = (cell for cell in notebook.cells if long in cell.source)
        assert cell.source.count(long) == 1, long
        cell.source = cell.source.replace(long, short)
    return notebook


@pytest.fixture(scope="module")
def client(tmp_path_factory):
    """One kernel for all notebooks: each more would import everything and load all kernels."""
    folder = tmp_path_factory.mktemp("notebooks")
    # without folders of kernels to look into, "python3" is this interpreter with its ipykernel
    manager = AsyncKernelManager(kernel_spec_manager=KernelSpecManager(kernel_dirs=[]))
    resources = {"metadata": {"path": str(folder)}}
    client = NotebookClient(new_notebook(), km=manager, resources=resources, **PATIENCE)
    with pytest.MonkeyPatch.context() as patch:
        # nobody's IPython start-up files, and no history left in a home
        patch.setenv("IPYTHONDIR", str(folder / "ipython"))
        yield client
        client.nb = new_notebook()
        client.execute(cleanup_kc=True)  # a manager that it did not make itself it would leave open


@each_notebook
def test_a_notebook_runs_from_start_to_end_without_a_warning(path, client):
    client.nb = notebook = read_shortened(path)
    notebook.cells.insert(0, new_code_cell("%reset -f"))  # it has no name of another notebook
    client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    errors = [output.text for output in outputs if output.get("name") == "stderr"]
    assert not [text for text in errors if "Warning" in text]


@each_notebook
def test_a_notebook_is_kept_without_outputs_and_with_nothing_of_a_machine(path):
    notebook = json.loads(path.read_text(encoding="utf-8"))
    assert notebook["metadata"] == {
        "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
        "language_info": {"name": "python"},
    }
    for cell in notebook["cells"]:
        assert cell["metadata"] == {}, cell["id"]
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [], f"{cell['id']}: clear all outputs before you save"
            assert cell["execution_count"] is None, cell["id"]


@each_notebook
def test_a_notebook_is_valid_and_its_cells_have_names_of_their_own(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    names = [cell["id"] for cell in notebook.cells]
    assert len(set(names)) == len(names)


@each_notebook
def test_the_first_cell_is_a_title_and_the_command_that_installs_what_it_needs(path):
    first = nbformat.read(path, as_version=4).cells[0]
    assert first.cell_type == "markdown"
    assert re.match(r"# \S", first.source)
    (extras,) = re.findall(r'^pip install "\.\[(.*)\]"$', first.source, re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {"notebooks"} <= set(extras.split(",")) <= set(project["optional-dependencies"])
