"""Dependencies point one way, and each heavy library lives in one room."""

import ast
from pathlib import Path

import pytest

import friction_estimator
from friction_estimator.effects import EFFECTS

PACKAGE = Path(friction_estimator.__file__).parent

# room: rooms it may use
ALLOWED = {
    "compiling": set(),
    "compiled": {"compiling"},
    "core": {"compiled", "compiling"},
    "startup": set(),
    "threads": set(),
    "streams": {"core"},
    "tasks": {"core", "startup", "threads"},
    "output": {"core"},
    "documents": {"core", "output"},
    "effects": {"compiled", "core"},
    "added_terms": {"core", "effects"},
    "rig": {"compiled", "core", "effects"},
    "bag": {"compiled", "core", "documents", "output"},
    "diagnosis": {"compiled", "core", "effects", "rig"},
    "paper": {"core", "rig"},
    "export": {"core"},
    "sweep": {"core", "added_terms", "bag", "tasks"},
    "fleet": {"core", "effects", "bag", "diagnosis", "tasks"},
    "report": {"core", "effects", "rig", "diagnosis", "paper", "sweep", "fleet"},
    "ros": {
        "core",
        "added_terms",
        "startup",
        "threads",
        "streams",
        "output",
        "documents",
        "effects",
        "bag",
        "report",
        "diagnosis",
        "rig",
    },
    "cli": {
        "compiling",
        "core",
        "added_terms",
        "startup",
        "threads",
        "streams",
        "output",
        "documents",
        "effects",
        "rig",
        "paper",
        "bag",
        "diagnosis",
        "export",
        "tasks",
        "sweep",
        "fleet",
        "report",
        "ros",
    },
    "__main__": {"cli"},
    "__init__": set(),
}

# inside core, room: rooms it may use; "top" are the modules at the top of core, the foundation of all
ALLOWED_IN_CORE = {
    "top": set(),
    "settings": {"top"},
    "intake": {"model", "settings", "top"},  # the known load is taken off at admission
    "model": {"settings", "top"},
    "fit": {"model", "settings", "top"},
    "online": {"fit", "model", "intake", "settings", "top"},
}

HOME = {
    "rclpy": {"ros"},
    "rosbags": {"bag"},
    "matplotlib": {"report"},
    "bokeh": {"report"},
    "jinja2": {"report"},
    "distributed": {"tasks"},
}

MODULES = sorted(PACKAGE.rglob("*.py"))


def room_of(path: Path) -> str:
    relative = path.relative_to(PACKAGE)
    return relative.parts[0] if len(relative.parts) > 1 else relative.stem


def imports_of(path: Path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name} line {node.lineno}: relative import"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_imports_follow_the_arrows(path):
    room = room_of(path)
    assert room in ALLOWED, f"{room} is a new room: say in this test what it may use"
    for name in imports_of(path):
        top, *rest = name.split(".")
        if top == "friction_estimator" and rest and (PACKAGE / rest[0]).with_suffix("").name in ALLOWED:
            assert rest[0] == room or rest[0] in ALLOWED[room], f"{path.name} in {room}/ imports {name}"
        if top in HOME:
            assert room in HOME[top], f"{path.name} in {room}/ imports {top}"
        assert room == "compiled" or name not in ("numba.njit", "numba.jit"), (
            f"{path.name} takes {name}, whose cache can end the program: take friction_estimator.compiled.njit"
        )


def literals_of(path):
    """Yield the string literals of a module, docstrings (of attributes too) excepted."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    words = {n.value for n in ast.walk(tree) if isinstance(n, ast.Expr) and isinstance(n.value, ast.Constant)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in words:
            yield node.lineno, node.value


NAMELESS = [p for p in MODULES if room_of(p) in ("diagnosis", "report")]


@pytest.mark.parametrize(
    "path",
    NAMELESS,
    ids=lambda p: str(p.relative_to(PACKAGE)),
)
def test_an_effect_is_named_in_its_class_only(path):
    """What steers the diagnosis is an attribute of the effect: a new one needs no other place."""
    for line, text in literals_of(path):
        named = [name for name in EFFECTS if text == name or ("_" in name and name in text)]
        assert not named, f"{path.name} line {line} names the effect {named[0]}"


PRINTERS = {
    "cli/terminal.py",
    "streams.py",
    "ros/parameter_file.py",  # config/estimator.yaml, made from the program's own words
}


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_one_place_prints(path):
    """What is said passes the border for text there: a name from outside could move the cursor, or forge a line."""
    if path.relative_to(PACKAGE).as_posix() in PRINTERS:
        return
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            words = ast.unparse(node.func)
            assert words not in ("print", "traceback.print_exc", "traceback.print_exception"), f"line {node.lineno}"
            assert not words.endswith(("stdout.write", "stderr.write")), f"line {node.lineno}"


CORE = PACKAGE / "core"


@pytest.mark.parametrize("path", sorted(CORE.rglob("*.py")), ids=lambda p: str(p.relative_to(CORE)))
def test_imports_inside_core_follow_the_arrows(path):
    within = path.relative_to(CORE).parts[:-1]
    room = within[0] if within else "top"
    assert room in ALLOWED_IN_CORE, f"core/{room} is a new room: say in this test what it may use"
    for name in imports_of(path):
        top, *rest = name.split(".")
        if top != "friction_estimator":
            continue
        if rest[0] in ("compiled", "compiling"):
            continue
        assert rest[0] == "core", f"{path.name} in core/ imports {name}"
        other = rest[1] if (CORE / rest[1]).is_dir() else "top"
        assert other == room or other in ALLOWED_IN_CORE[room], f"{path.name} in core/{room} imports {name}"


def test_the_measured_data_are_reached_through_their_fixture_only():
    """Another way would neither be marked `shared` nor be skipped where the data are absent."""
    here = Path(__file__)
    for path in here.parent.glob("*.py"):
        if path not in (here, here.with_name("conftest.py")):
            constants = [n.value for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Constant)]
            assert not any("shared" in word.split("/") for word in constants if isinstance(word, str)), path.name


@pytest.mark.parametrize("path", MODULES, ids=lambda p: str(p.relative_to(PACKAGE)))
def test_modules_stay_readable(path):
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 450
