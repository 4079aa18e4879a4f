"""Configurations, extended models and states under attack: sound ones, and what the program does with them."""

import hashlib
import json
import random
from pathlib import Path

import numpy as np
from hard import mutators as m
from hard.fuzzing import Kind

from friction_estimator.cli.terminal import guarded
from friction_estimator.core.errors import about
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import meet
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import PARAMETERS, Config
from friction_estimator.documents.configuration import read_config, write_config
from friction_estimator.effects.extension import extension_from_config
from friction_estimator.ros.state import dumps, read_state

_BASE = {
    "theory.kind": "seal",
    "basis.velocity_range": [-0.12, 0.12],
    "force_unit": 5.0,
    "fir.order": 2,
    "basis.finest_level": 1,
}
_TERMS = ("inertia", "side_spring:centre=0.0", "viscosity_drift:time_constant=30.0,from=0.0,to=9.0")
_ANNOTATED = Path(__file__).parents[2] / "config" / "estimator.yaml"


def _samples(n: int = 240) -> Samples:
    t = 0.005 * np.arange(n)
    v = 0.1 * np.sin(2 * np.pi * 2.0 * t)
    return Samples(
        1_700_000_000 * 10**9 + 5_000_000 * np.arange(n), v, 5 * np.tanh(v / 0.01) + 20 * v, np.arange(n) == 0
    )


def _learn(path: Path) -> int:
    """Read a configuration and learn by it as `replay` does; its figures and its report are left out."""

    def body() -> int:
        with about(path):
            config = meet(read_config(path), _samples()).config
            estimator = Estimator(config, extension_from_config(config))
        estimator.run(_samples())
        estimator.curve()
        return 0

    return guarded("friction_estimator replay", body)


def _yaml(folder: Path, data: bytes) -> Path:
    path = folder / "input.yaml"
    path.write_bytes(data)
    return path


def _configurations(folder: Path) -> list[bytes]:
    write_config(folder / "given.yaml", Config.from_mapping(_BASE))
    estimator = Estimator(Config.from_mapping(_BASE))
    estimator.run(_samples())
    write_config(folder / "warm.yaml", estimator.learned_config)
    return [_ANNOTATED.read_bytes(), *((folder / name).read_bytes() for name in ("given.yaml", "warm.yaml"))]


def _extended(folder: Path) -> list[bytes]:
    found = []
    for count in (1, 2, 3):
        config = Config.from_mapping({**_BASE, "extension.terms": _TERMS[:count]})
        estimator = Estimator(config, extension_from_config(config))
        estimator.run(_samples())
        write_config(folder / "extended.yaml", estimator.learned_config)
        found.append((folder / "extended.yaml").read_bytes())
    return found


def _states(folder: Path) -> list[bytes]:
    del folder
    found = []
    for law in ("rls", "nlms", "lms"):
        estimator = Estimator(Config.from_mapping(_BASE | {"model.law": law}))
        estimator.run(_samples())
        found.append(dumps(estimator.state()))
    return found


def _restore(path: Path) -> int:
    """Take a state over as the node does, and go on with it."""

    def body() -> int:
        state = read_state(path)
        law = str(state.get("structure", {}).get("model.law"))
        estimator = Estimator(Config.from_mapping(_BASE | ({"model.law": law} if law in ("lms", "nlms") else {})))
        with about(path):
            estimator.restore(state)
        assert np.isfinite(estimator.run(_samples())).all()
        curve = estimator.curve()
        assert np.isfinite(curve.low_N).all()
        assert np.isfinite(curve.high_N).all()
        return 0

    return guarded("friction_estimator node", body)


def setting(rng: random.Random, data: bytes) -> bytes:
    """Add a setting, of any name and with an awkward value."""
    item = rng.choice(list(PARAMETERS.values()))
    numbers = [item.low, item.high, item.least, 1e-12, -1e-12, 0.0, 1.0, -1.0, 1e6, 1e9, rng.lognormvariate(0.0, 9.0)]
    values = [repr(float(v)) for v in numbers if abs(v) < 1e308] + [str(int(v)) for v in numbers if abs(v) < 1e18]
    values += [*item.choices, "true", "''", "[]", "{}", "~", "x: y"]
    value = rng.choice(values)
    if item.is_array or rng.random() < 0.1:
        value = "[" + ", ".join(rng.choice(values) for _ in range(rng.choice((0, 1, 2, 2, 3, 40)))) + "]"
    return data.rstrip(b"\n") + f"\n    {item.name}: {value}\n".encode()


def resealed(rng: random.Random, data: bytes) -> bytes:
    """Change the content of a state under a checksum that fits: its text, a value, or numbers of an array."""
    try:
        document = json.loads(data)
        content = json.loads(document["content"])
        place = content["estimator"]
        pick = rng.random()
        if pick < 0.3:
            text = m.text_token(rng, document["content"].encode()).decode("utf-8", "surrogatepass")
        else:
            array = rng.choice(list(place["arrays"].values()))
            if pick < 0.8:
                array["array"] = _with_numbers(rng, array)
            elif pick < 0.9:
                array["shape"] = [rng.choice((0, 1, -1, 3, 42, 10**9)) for _ in range(rng.choice((0, 1, 2, 3)))]
            else:
                group = place[rng.choice(("structure", "chosen"))]
                group[rng.choice(list(group))] = rng.choice((None, [], {}, 1e300, -1, "x", [1, 2], [[1]], True))
            text = json.dumps(content)
    except (ValueError, LookupError, TypeError, AttributeError, OverflowError):  # it was changed before
        return m.flip(rng, data)
    digest = hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()
    return json.dumps(document | {"sha256": digest, "content": text}).encode()


def _with_numbers(rng: random.Random, array: dict[str, str]) -> str:
    import base64

    values = np.frombuffer(base64.b64decode(array["array"]), array["type"]).copy()
    awkward = [0.0, -1.0, 1.0, 0.5, 2.0, 1e-300, 1e6, 1e12, 1e60, 1e308, -1e308, np.inf, np.nan]
    if values.dtype.kind == "i":
        awkward = [0, -1, 1, 2, 2**53, 2**62, -(2**63)]
    for _ in range(rng.choice((1, 1, 5))):
        if values.size:
            values[rng.randrange(values.size)] = rng.choice(awkward)
    return base64.b64encode(values.tobytes()).decode()


def _state_file(folder: Path, data: bytes) -> Path:
    path = folder / "state.json"
    path.write_bytes(data)
    return path


KINDS = {
    "configuration": Kind(_configurations, _yaml, _learn, (m.text_token, m.text_line, setting, setting)),
    "extended": Kind(_extended, _yaml, _learn, (m.text_token, m.text_token, m.text_line, setting)),
    "state": Kind(_states, _state_file, _restore, (resealed, resealed, m.text_token)),
}
