"""The house: which folder may import which, how long a module may be, and what `import workbench` loads."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import workbench as wb

PACKAGE = Path(wb.__file__).parent
MODULES = sorted(PACKAGE.rglob("*.py"))

# Data flows one way: what each folder may import of ours besides itself and errors.
ALLOWED = {
    "model": set(),
    "kpi": {"model"},
    "record": {"model"},
    "simulate": {"model", "kpi"},
    "symbolic": {"model"},
    "detect": {"model", "kpi", "record", "simulate"},
    "estimate": {"model", "kpi", "record", "simulate", "symbolic", "detect"},
    "analyze": {"model", "kpi", "simulate", "symbolic"},
    "tune": {"model", "kpi", "simulate", "symbolic", "analyze"},
    "report": {"model", "kpi"},
    "scenario": {"model", "kpi", "record", "simulate", "detect", "estimate", "analyze", "tune", "report"},
    "fleet": {"model", "kpi", "record", "simulate", "detect", "estimate", "analyze", "tune", "scenario", "report"},
    "ui": {"model", "kpi", "record", "simulate", "detect", "estimate", "analyze", "tune", "report", "scenario"},
    "cli": {"model", "record", "estimate", "report", "scenario", "fleet", "ui", "score"},
}


# And within the folder that estimates: each knows those before it, and none what lies beside them.
ESTIMATE = ("kernels", "fits", "search", "loads", "ranges", "methods")


def imports(path: Path, within: str = "workbench") -> set[str]:
    """What a module imports of a package: folders and modules right below it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    start = f"{within}."
    return {name.removeprefix(start).split(".")[0] for name in names if name.startswith(start)} - {"__version__"}


def test_every_folder_has_its_place():
    folders = {p.name for p in PACKAGE.iterdir() if p.is_dir() and any(p.glob("*.py"))}
    assert folders == set(ALLOWED)


@pytest.mark.parametrize("folder", sorted(ALLOWED))
def test_data_flows_one_way(folder):
    for path in (PACKAGE / folder).rglob("*.py"):
        extra = imports(path) - ALLOWED[folder] - {folder, "errors"}
        assert not extra, f"{path.relative_to(PACKAGE)} imports {sorted(extra)}"


@pytest.mark.parametrize("folder", ESTIMATE)
def test_what_estimates_stands_on_what_comes_before(folder):
    assert {p.name for p in (PACKAGE / "estimate").iterdir() if p.is_dir() and any(p.glob("*.py"))} == set(ESTIMATE)
    for path in (PACKAGE / "estimate" / folder).glob("*.py"):
        extra = imports(path, "workbench.estimate") - set(ESTIMATE[: ESTIMATE.index(folder) + 1])
        assert not extra, f"{path.relative_to(PACKAGE)} imports {sorted(extra)}"


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_say_what_they_hold_and_stay_short(path):
    text = path.read_text()
    assert ast.get_docstring(ast.parse(text)), "a module's first lines say what lives there"
    assert len(text.splitlines()) <= 500


def test_importing_the_package_loads_nothing_heavy():
    code = (
        "import sys, workbench; workbench.FOPDT; "
        "heavy = {'numpy', 'casadi', 'numba', 'scipy', 'matplotlib', 'pydantic', 'pyarrow'} & set(sys.modules); "
        "assert heavy <= set(), heavy"
    )
    # FOPDT needs plain Python alone; records and runs need numpy.
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


def test_every_public_name_is_there_and_stays_the_public_one():
    for name in wb.__all__:
        assert getattr(wb, name) is not None
    for name in ("simulate", "detect", "estimate", "tune"):
        assert callable(getattr(wb, name)), "the folder of this name must not take its place"
    with pytest.raises(AttributeError, match="no attribute 'simulte'"):
        _ = wb.simulte


def test_public_functions_survive_imports_of_their_folders():
    code = (
        "import workbench.simulate.kernel, workbench.tune.tune, workbench.estimate.estimate; import workbench as wb; "
        "assert callable(wb.simulate) and callable(wb.tune) and callable(wb.estimate)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("folder", ["detect", "estimate", "analyze", "tune"])
def test_numbers_in_words_follow_the_one_law(folder):
    # `:.3g` writes 1290 s as 1.29e+03; see `workbench.model.numbers`.
    told = {path.name: re.findall(r"\{[^{}]*:\.\d+g\}", path.read_text()) for path in (PACKAGE / folder).rglob("*.py")}
    assert not {name: found for name, found in told.items() if found}
