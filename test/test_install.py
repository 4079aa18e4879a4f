"""What an installation brings: dependencies declared once and alike, and help and outputs as a user meets them."""

import ast
import re
import shutil
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from pathlib import Path
from xml.etree import ElementTree

import pytest

from friction_estimator.cli import main
from friction_estimator.cli.terminal import WIDEST_HELP
from friction_estimator.core.errors import EXTRAS as EXTRA_OF

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "friction_estimator"

IMPORTED_AS = {"PyWavelets": "pywt", "PyYAML": "yaml", "backports.zstd": "backports"}
"""Distribution -> module, where the names differ."""

ROSDEP = {"PyYAML": "python3-yaml", "rosbags": "python3-rosbags-pip"}
"""Distribution -> key of rosdep, where it is not python3-NAME."""

WITHOUT_KEY = {"PyWavelets", "apsw", "lz4", "backports.zstd"}
"""PyWavelets has no key (the README names Ubuntu's package), rosbags brings the others."""

WITH_BOKEH = {"jinja2", "markupsafe", "tornado"}
"""What bokeh itself depends on."""


def named(requirement: str) -> str:
    return re.match(r"[A-Za-z0-9._-]+", requirement)[0]


def literal(name: str):
    """Return a constant of setup.py, which cannot be imported without running it."""
    for node in ast.parse((ROOT / "setup.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Assign) and node.targets[0].id == name:
            return ast.literal_eval(node.value)
    raise AssertionError(f"setup.py has no {name}")


REQUIRED, EXTRAS = literal("REQUIRED"), literal("EXTRAS")


def test_requirements_and_setup_name_the_same_floors():
    lines = (ROOT / "requirements.in").read_text(encoding="utf-8").splitlines()
    given = {named(line): line.split("#")[0].strip() for line in lines if line.strip() and not line.startswith("#")}
    for requirement in [*REQUIRED, *(one for many in EXTRAS.values() for one in many)]:
        assert given.get(named(requirement)) == requirement


def test_package_xml_has_a_key_for_each_run_time_dependency_and_no_other():
    keys = {node.text for node in ElementTree.parse(ROOT / "package.xml").iter("exec_depend")}
    wanted = {ROSDEP.get(name, f"python3-{name.lower()}") for name in map(named, REQUIRED) if name not in WITHOUT_KEY}
    assert {key for key in keys if key.startswith("python3-")} == wanted


def test_all_that_is_imported_is_declared():
    declared = {IMPORTED_AS.get(name, name) for name in map(named, [*REQUIRED, *EXTRAS["page"], *EXTRAS["terminal"]])}
    declared |= {named(one) for one in (*EXTRAS["parquet"], *EXTRAS["cluster"])} | WITH_BOKEH
    messages = {node.text for node in ElementTree.parse(ROOT / "package.xml").iter("exec_depend")}
    ros = {key for key in messages if not key.startswith("python3-")} | {"builtin_interfaces", "rosbag2_interfaces"}
    found = {}
    for path in PACKAGE.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module]
            found |= {name.partition(".")[0]: path.name for name in names}
    ours = {*sys.stdlib_module_names, "friction_estimator", "compression"}
    assert {name: path for name, path in found.items() if name not in ours | declared | ros} == {}


def test_an_extra_is_named_where_its_module_is_missing():
    for module, extra in EXTRA_OF.items():
        brings = {"rclpy": "ros-jazzy-rclpy", "jinja2": "bokeh"}.get(module, module)
        assert brings in map(named, EXTRAS[extra])


def test_what_is_installed_here_declares_what_setup_declares():
    try:
        declared = requires("friction_estimator") or []
    except PackageNotFoundError:
        pytest.skip("friction_estimator is not installed here, only on the path")
    told = {line.replace(" ", "").replace('"', "'") for line in declared if "extra ==" not in line}
    if {named(line) for line in told} == {"setuptools"}:
        pytest.skip("installed before its dependencies were declared: pip install --editable . again")
    assert told == {line.replace(" ", "") for line in REQUIRED}
    assert version("friction_estimator") == ElementTree.parse(ROOT / "package.xml").find("version").text


def test_nothing_that_the_program_imports_checks_requirements_at_run_time():
    """Scripts that colcon makes set __requires__, which pkg_resources would hold against every dependency at import."""
    code = (
        "import importlib, sys\n"
        "from friction_estimator.cli.main import VERBS\n"
        "for module, _ in VERBS.values(): importlib.import_module(f'friction_estimator.cli.{module}')\n"
        "import friction_estimator.ros.estimator_node, friction_estimator.report.figures\n"
        "print(sorted({name.partition('.')[0] for name in sys.modules} & {'pkg_resources', 'setuptools'}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("columns", ["60", "80", "200"])
@pytest.mark.parametrize("verb", [None, *main.VERBS])
def test_help_fits_the_terminal_and_a_hundred_columns(verb, columns, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    with pytest.raises(SystemExit):
        main.main([*([verb] if verb else []), "--help"])
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= WIDEST_HELP
    described = text.split("\n\n")[1]  # what is indented stays as it is written
    assert max(len(line) for line in described.splitlines() if not line.startswith(" ")) <= int(columns)


def outputs_in_documents():
    texts = [ROOT / "README.md", ROOT / "Makefile", *(ROOT / "docs").glob("*.md"), *(PACKAGE / "cli").glob("*.py")]
    for path in texts:
        for name in re.findall(r"--out ([a-z0-9_]+(?:\.h)?)(?=[\s\"`])", path.read_text(encoding="utf-8")):
            if name not in ("has", "and"):  # prose
                yield name


@pytest.mark.skipif(shutil.which("git") is None or not (ROOT / ".git").exists(), reason="no git clone")
def test_what_the_documented_commands_write_is_ignored_by_git():
    names = sorted({name if "." in name else f"{name}/" for name in outputs_in_documents()})
    assert {"rig_b/", "replayed/", "diagnosed/", "friction_model.h"} <= set(names)
    done = subprocess.run(["git", "check-ignore", *names], capture_output=True, text=True, cwd=ROOT, check=False)
    assert set(names) - set(done.stdout.split()) == set()
