"""One recording, diagnosed: a row of a fleet's table.

Runs in a worker process: nothing that draws or talks to ROS is imported here.
"""

from typing import Any

from friction_estimator.core.errors import about
from friction_estimator.core.settings.config import Config
from friction_estimator.diagnosis.diagnose import diagnose
from friction_estimator.diagnosis.summary import as_json
from friction_estimator.effects.base import EFFECTS
from friction_estimator.fleet.job import Job
from friction_estimator.fleet.reading import read_to_diagnose

EARLIEST_NS = 946_684_800 * 1_000_000_000
"""The year 2000: recordings that begin before it count from a zero of their own and have no date."""


def row_of(job: Job) -> dict[str, Any]:
    """Return the row: `diagnose --json` of the recording, without names of files, in each effect and fault `what` it
    is in words, and

    `start_ns` (when the recording began; None where its clock does not say), `duration_s`, `samples`, `rate_hz`.

    Raises as `diagnose` does.
    """
    job.recording.check_unchanged()
    config = Config.from_mapping(job.settings)
    read = read_to_diagnose(job.recording.path, config, job.topics)
    config = config.updated({"input.motion": read.recording.motion})
    samples = read.admitted.samples
    faults = {fault.name: fault for fault in read.faults}
    with about(job.recording.path):
        result = diagnose([samples], config, seed=job.seed, faults=tuple(faults.values()))
    summary = as_json(result, [], {}, None, config.quantities)
    begin = min(int(stream.log_time_ns.min()) for stream in read.recording.streams.values())
    found = {name: value for name, value in summary.items() if name not in ("schema", "bags", "extended_model")}
    for item in (*found["effects"], *found["faults"]):
        del item["figure"]
        # In words here, where the effects are loaded: the page of the table then needs none of them.
        item["what"] = config.quantities.si.worded(EFFECTS[item["name"]].words.what)
    return found | {
        "start_ns": begin if begin >= EARLIEST_NS else None,
        "duration_s": samples.duration_s,
        "samples": len(samples),
        "rate_hz": samples.sample_rate_hz,
    }
