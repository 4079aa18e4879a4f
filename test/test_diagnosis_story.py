"""The whole story: a recording with a hidden cause, its diagnosis, the extended model live beside another recording."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_graph
from geometry_msgs.msg import WrenchStamped
from ros_graph import LIMIT_S, await_, force

from friction_estimator.bag.read import read_recording
from friction_estimator.bag.samples import to_samples
from friction_estimator.cli.main import main
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.online.replay import replay
from friction_estimator.documents.configuration import read_config
from friction_estimator.effects import extension_from_config

pytestmark = pytest.mark.ros

LEARNED = "1:50:5,4:50:8,1:200:5,4:200:8,1:50:5,4:50:8"
OTHER = "3:120:6,1.5:80:6:triangle,2:150:6"
"""Other periods, another profile, other pressures in another order."""

SPEED = 8.0
"""Times the recorded pace at which the other recording is played."""


@dataclass(frozen=True)
class Story:
    """Two recordings of one rig, the diagnosis of the first, and the base model that was learned from it.

    Attributes
    ----------
    other : the second recording. summary : of the diagnosis. extended : its file, or None. base : file.
    """

    other: Path
    summary: dict[str, Any]
    extended: Path | None
    base: Path


def told(folder: Path, hidden: list[str], warmth: tuple[float, float] | None = None) -> Story:
    """Simulate both recordings, at a temperature each where given; diagnose the first and learn from it."""
    bags = []
    for number, schedule in enumerate((LEARNED, OTHER)):
        bag = folder / f"run{number}"
        words = ["simulate", "--out", str(bag), "--plant", "clean", "--rate", "200", "--seed", str(number + 4)]
        words += ["--schedule", schedule, *(w for effect in hidden for w in ("--effect", effect))]
        if warmth is not None:
            words += ["--temperature", str(warmth[number])]
        assert main(words) == 0
        bags.append(bag)
    learned, other = bags
    out, base = folder / "diagnosed", folder / "learned"
    assert main(["diagnose", str(learned), "--out", str(out), "--json", str(folder / "diagnosis.json")]) == 0
    assert main(["replay", str(learned), "--out", str(base)]) == 0
    summary = json.loads((folder / "diagnosis.json").read_text())
    extended = summary["extended_model"]
    assert (out / "extended.yaml").exists() == (extended is not None)
    return Story(other, summary, Path(extended) if extended else None, base / "config.yaml")


def live_error(graph: ros_graph.Graph, bag: Path, config: Path) -> float:
    """Play a recording to a node with this configuration; return its error, bit-equal to that of `replay`."""
    node = graph.start_node(units=False, arguments=("--params-file", str(config)))
    topic = "/friction_estimator/friction_predicted"
    heard = graph.hear(WrenchStamped, topic, raw=True)
    graph.heard_by(topic)
    player = graph.start("-m", "friction_estimator", "play", str(bag), "--rate", str(SPEED))
    assert player.popen.wait(LIMIT_S) == 0, player.output()
    settings = read_config(config)
    samples = to_samples(read_recording(bag, settings.input), settings).samples
    await_(lambda: len(heard) >= len(samples), "all predictions")
    assert node.stop() == 0
    stamps, values = zip(*(force(bytes(raw)) for raw in heard), strict=True)
    assert list(stamps) == samples.stamp_ns.tolist()
    predicted = np.array(values)
    offline = replay(samples, settings, extension=extension_from_config(settings))
    np.testing.assert_array_equal(predicted, offline.predicted_N)
    said = graph.folder / f"{config.stem}.json"
    assert main(["replay", str(bag), "--config", str(config), "--json", str(said)]) == 0
    error = nrmse(samples.friction_N, predicted)
    assert error == json.loads(said.read_text())["nrmse"]
    return error


@pytest.mark.parametrize(
    ("hidden", "warmth"),
    [("inertia:size=0.04", None), ("presliding:size=0.06", (40.0, 48.0))],
    ids=["inertia", "presliding, temperature recorded"],
)
def test_a_hidden_cause_is_named_and_the_extended_model_is_better_live(
    tmp_path: Path, hidden: str, warmth: tuple[float, float] | None
) -> None:
    story = told(tmp_path, [hidden], warmth)
    assert story.summary["verdict"] == "effects_found"
    assert [effect["name"] for effect in story.summary["effects"]] == [hidden.split(":", maxsplit=1)[0]]
    assert "temperature" in story.summary["excitation"]["channels"]
    assert story.extended is not None
    with ros_graph.graph(tmp_path) as graph:
        base = live_error(graph, story.other, story.base)
    with ros_graph.graph(tmp_path) as graph:
        extended = live_error(graph, story.other, story.extended)
    assert extended < 0.7 * base


def test_where_nothing_is_hidden_nothing_is_offered(tmp_path: Path) -> None:
    story = told(tmp_path, [])
    assert story.summary["verdict"] == "nothing_found"
    assert story.summary["extended_model"] is None
    assert story.summary["effects"] == []
    with ros_graph.graph(tmp_path) as graph:
        assert live_error(graph, story.other, story.base) < 0.03
