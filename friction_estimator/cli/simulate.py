"""`simulate`: the rig simulation writes a recording, with effects hidden in it on request."""

import argparse
from typing import Any

import numpy as np

from friction_estimator.bag.write import STORAGES, TOPICS, RecordingWriter, refusal_at, storage_of, written
from friction_estimator.cli import common
from friction_estimator.cli.progress import progress
from friction_estimator.cli.terminal import say_document, warn
from friction_estimator.core.errors import InputError
from friction_estimator.core.metrics import nrmse
from friction_estimator.core.quantities import FORCE, LINEAR, ROTARY, VELOCITY, Quantities
from friction_estimator.core.sample import Bools, Floats
from friction_estimator.core.settings.config import Config
from friction_estimator.documents.configuration import read_config
from friction_estimator.effects import extension_from_config, list_effects, parse_effect
from friction_estimator.rig.drive import (
    CONDITION_SECONDS,
    CONDITIONS,
    PA_PER_PSI,
    Segment,
    celsius,
    parse_schedule,
    segment,
)
from friction_estimator.rig.identified import IdentifiedPlant
from friction_estimator.rig.plant import PLANTS, Law
from friction_estimator.rig.profiles import PROFILES, Geometry
from friction_estimator.rig.sensors import stamps
from friction_estimator.rig.simulate import Scenario, Simulation, simulate

SCHEMA = "friction_estimator/simulate/1"

CHANNEL_PERIOD_S = 0.1
"""Pressure and temperature are sent when they change, and at least this often."""

_DEFAULT_CONDITION = "b"
_DEFAULT_PLANT = "rig"

JOINT_STATES = "/joint_states"
"""Topic of a rotary plant, whose position, velocity and effort come in one message."""

HALF_TURN_RAD = 1.0
"""Half stroke of a rotary plant, rad."""

ROD = 5.0
"""Length of the connecting rod over the half stroke."""


def add_parser(subparsers: common.Subparsers) -> None:
    """Add the verb's parser."""
    parser = common.add_verb(
        subparsers,
        "simulate",
        "the rig simulation writes a recording",
        description="Simulate a lip seal on a rig and write what its sensors show. The same options and seed give the "
        "same recording. Conditions (the paper's Fig. 4, gauge pressure, 130 degF): a is T = 5 s at 50 psi, b is "
        "T = 1 s at 50 psi, c is T = 5 s at 200 psi.",
        example="friction_estimator simulate --out bags/inertia --plant clean --seed 7 \\\n"
        "      --schedule 5:50:60:crank,1:200:30:crank --effect inertia:mass=2 --effect sensor_bias:size=0.02",
    )
    parser.add_argument("--out", metavar="BAG", help="recording to write: a folder, or a bare .mcap or .db3 file")
    parser.add_argument("--storage", choices=STORAGES, help="format (default: by the name of BAG, else mcap)")
    drive = parser.add_argument_group("drive")
    what = drive.add_mutually_exclusive_group()
    what.add_argument("--condition", choices=CONDITIONS, help=f"condition of the paper (default: {_DEFAULT_CONDITION})")
    what.add_argument(
        "--schedule",
        metavar="SEGMENT,...",
        help="segments one after the other, each PERIOD:PRESSURE_PSI:SECONDS[:PROFILE], of the whole number of cycles "
        f"nearest to SECONDS; profiles: {', '.join(PROFILES)} (default: sine)",
    )
    length = drive.add_mutually_exclusive_group()
    length.add_argument("--cycles", type=int, metavar="N", help="length of a condition in cycles")
    length.add_argument(
        "--seconds", type=float, metavar="S", help=f"length of a condition, s (default: {CONDITION_SECONDS:g})"
    )
    drive.add_argument(
        "--eccentric",
        type=float,
        metavar="M",
        help=f"half stroke, m or rad (default: {Geometry().eccentric_m:g} m; {HALF_TURN_RAD:g} rad for a rotary plant)",
    )
    drive.add_argument(
        "--rod",
        type=float,
        metavar="M",
        help="connecting rod of the profile crank, m (default: five times the half stroke)",
    )
    oil = drive.add_mutually_exclusive_group()
    oil.add_argument("--temperature", type=float, metavar="DEGC", help="oil temperature, degC (default: 54.44)")
    oil.add_argument("--temperature-degf", type=float, metavar="DEGF", help="the same in degF (default: 130)")
    rig = parser.add_argument_group("rig")
    rig.add_argument(
        "--plant",
        choices=PLANTS,
        metavar="NAME",
        help=f"one of {', '.join(PLANTS)}. rig: realistic, asymmetric, its film lags; clean: differs from the theory "
        "only by what the diagnosis base can learn; pendulum, geared_joint: rotary, with inertia and gravity in the "
        f"effort, written as {JOINT_STATES} (default: {_DEFAULT_PLANT})",
    )
    rig.add_argument(
        "--config",
        metavar="YAML",
        help="ROS parameter file: a learned or extended model in it plays the plant (at the rate at which it was "
        "learned); else its seal.* is the theory from which the plants depart",
    )
    rig.add_argument("--rate", type=float, default=1000.0, metavar="HZ", help="sample rate (default: %(default)g)")
    rig.add_argument(
        "--noise",
        type=float,
        default=0.01,
        metavar="R",
        help="rms of the force noise over the rms of the clean friction (default: %(default)s)",
    )
    rig.add_argument(
        "--seed", type=int, default=0, metavar="S", help="seed of everything random (default: %(default)s)"
    )
    rig.add_argument(
        "--effect",
        action="append",
        default=[],
        metavar="NAME[:key=value,...]",
        help="hide an effect; size=R makes it change the friction by R of its rms; may be repeated",
    )
    rig.add_argument("--list-effects", action="store_true", help="print the effects with keys, units, ranges as JSON")
    common.add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Run the verb."""
    if args.list_effects:
        say_document(common.to_json(list_effects()))
        return 0
    if args.out is None:
        raise InputError("--out BAG is missing: name the recording to write")
    inputs = common.paths_read(args)
    storage = storage_of(args.out, args.storage)
    with common.Output(args.json, args.out, refusal_at(args.out), inputs) as output:
        return _run(args, output, storage)


def _run(args: argparse.Namespace, output: common.Output, storage: str) -> int:
    config = read_config(args.config) if args.config else Config()
    scenario = scenario_from(args, config)
    run_ = simulate(scenario, _identified(args, config, scenario))
    learned = bool(config.learned.wavelet_weights)
    quantities = config.quantities if learned else Quantities(PLANTS[scenario.plant].motion)
    _warn_outside(config, run_)
    with (
        progress("writing", unit="messages") as advance,
        output.part() as part,
        written(part, storage, advance) as writer,
    ):
        add_recording(writer, run_, quantities.motion if learned else LINEAR)
    summary = summarise(args.out, run_, "identified" if learned else scenario.plant)
    _tell(output, run_, summary, quantities)
    output.result(summary)
    return 0


def scenario_from(args: argparse.Namespace, config: Config) -> Scenario:
    """Return the scenario that the options describe; InputError or ConfigError where they describe none."""
    temperature = celsius(130.0)
    if args.temperature is not None:
        temperature = args.temperature
    elif args.temperature_degf is not None:
        temperature = celsius(args.temperature_degf)
    return Scenario(
        segments=_segments(args),
        plant=args.plant or _DEFAULT_PLANT,
        rate_hz=args.rate,
        noise=args.noise,
        seed=args.seed,
        effects=tuple(parse_effect(text) for text in args.effect),
        temperature_degC=temperature,
        geometry=_geometry(args),
        seal=config.seal,
    )


def _geometry(args: argparse.Namespace) -> Geometry:
    rotary = PLANTS[args.plant or _DEFAULT_PLANT].motion == ROTARY
    half = args.eccentric
    if half is None:
        half = HALF_TURN_RAD if rotary else Geometry().eccentric_m
    return Geometry(half, ROD * half if args.rod is None else args.rod)


def _identified(args: argparse.Namespace, config: Config, scenario: Scenario) -> Law | None:
    """Return the model that plays the plant, where the configuration has learned one."""
    if not config.learned.wavelet_weights:
        return None
    if args.plant is not None:
        raise InputError(
            f"--plant {args.plant}: {args.config} holds a learned model, which is the plant; leave one out"
        )
    for effect in scenario.effects:
        if effect.stage == "lubrication":
            raise InputError(
                f"--effect {effect.name} acts on the oil film, and the model in {args.config} has none; "
                "use --plant rig or clean"
            )
    return IdentifiedPlant(config, scenario.rate_hz, extension_from_config(config))


def _warn_outside(config: Config, run_: Simulation) -> None:
    if not config.learned.wavelet_weights:
        return
    assert config.reach is not None
    low, high = config.reach
    velocity = run_.samples.velocity_m_s
    outside = np.count_nonzero((velocity < low) | (velocity > high))
    if outside:
        told = config.quantities.range_text((low, high), VELOCITY, "g")
        warn(f"{outside} samples lie outside the learned velocities {told}: g is held there")


def _segments(args: argparse.Namespace) -> tuple[Segment, ...]:
    if args.schedule is not None:
        for option in ("cycles", "seconds"):
            if getattr(args, option) is not None:
                raise InputError(f"--{option} goes with --condition: a schedule states its own SECONDS")
        return parse_schedule(args.schedule)
    period, pressure = CONDITIONS[args.condition or _DEFAULT_CONDITION]
    if args.cycles is not None:
        return (Segment(period, pressure * PA_PER_PSI, args.cycles),)
    return (segment(period, pressure, CONDITION_SECONDS if args.seconds is None else args.seconds),)


def add_recording(writer: RecordingWriter, run_: Simulation, motion: str = LINEAR) -> None:
    """Add what the sensors of a simulated run show to a recording, on the default topics.

    Header stamps are the sensors' (faults of their clocks included), the time of recording is the true one. Pressure
    and temperature are sent when they change and at least every 0.1 s: held values are exact. A rotary plant is written
    as a joint, and a learned model of a rotary `motion` as what it was learned from, angular velocity and torque.
    """
    samples, scenario = run_.samples, run_.scenario
    true_ns = stamps(len(samples), scenario.rate_hz, scenario.start_ns)
    if PLANTS[scenario.plant].motion == ROTARY:
        values = {"position": samples.position_m, "velocity": samples.velocity_m_s, "friction": samples.friction_N}
        present = {name: value for name, value in values.items() if value is not None}
        kind = TOPICS["position"][1]
        writer.add_stream(JOINT_STATES, kind, samples.stamp_ns, present, log_time_ns=true_ns, frame_id="rig")
        return
    every = max(1, round(CHANNEL_PERIOD_S * scenario.rate_hz))
    whole = np.ones(len(samples), np.bool_)
    channels: list[tuple[str, Floats | None, Bools]] = [
        ("pressure", samples.pressure_Pa, _sent(samples.pressure_Pa, every)),
        ("temperature", samples.temperature_degC, _sent(samples.temperature_degC, every)),
        ("position", samples.position_m, whole),
        ("velocity", samples.velocity_m_s, whole),
        ("friction", samples.friction_N, whole),
    ]
    for name, value, sent in channels:
        if value is None:
            continue
        stamp_ns = run_.friction_stamp_ns if name == "friction" else samples.stamp_ns
        topic, kind = TOPICS[name]
        writer.add_stream(
            topic,
            kind,
            stamp_ns[sent],
            value[sent],
            quantity=name,
            log_time_ns=true_ns[sent],
            frame_id="rig",
            motion=motion,
        )


def _sent(value: Floats | None, every: int) -> Bools:
    """Return where a channel sends: at the start, at each change, and every `every` samples."""
    if value is None:
        return np.zeros(0, np.bool_)
    sent = np.arange(value.size) % every == 0
    sent[1:] |= value[1:] != value[:-1]
    return np.asarray(sent)


def summarise(bag: str, run_: Simulation, plant: str) -> dict[str, Any]:
    """Return the JSON of a simulation: what was asked for, and the truth."""
    scenario = run_.scenario
    return {
        "schema": SCHEMA,
        "bag": bag,
        "plant": plant,
        "schedule": scenario.segments,
        "samples": len(run_.samples),
        "sample_rate_hz": scenario.rate_hz,
        "duration_s": scenario.duration_s,
        "temperature_degC": scenario.temperature_degC,
        "eccentric_m": scenario.geometry.eccentric_m,
        "rod_m": scenario.geometry.rod_m,
        "noise": scenario.noise,
        "seed": scenario.seed,
        "topics": {"joint_states": JOINT_STATES}
        if PLANTS[scenario.plant].motion == ROTARY
        else {name: topic for name, (topic, _) in TOPICS.items()},
        "truth": {
            "clean_friction_rms_N": _rms(run_.clean_N),
            "noise_rms_N": _rms(run_.noise_N),
            "theory_nrmse": nrmse(run_.clean_N, run_.theory_N),
            "load": getattr(PLANTS[scenario.plant], "loads", {}),
            "effects": [
                {"name": effect.name, "spec": effect.spec, "values": effect.values, "size": size}
                for effect, size in zip(run_.effects, run_.sizes, strict=True)
            ],
        },
    }


def _tell(output: common.Output, run_: Simulation, summary: dict[str, Any], quantities: Quantities) -> None:
    scenario, truth = run_.scenario, summary["truth"]
    for part in scenario.segments:
        output.say(
            f"{'segment':<12}{part.cycles} cycles of {part.period_s:g} s, {part.profile}, "
            f"{part.pressure_Pa / PA_PER_PSI:g} psi gauge ({part.pressure_Pa:.6g} Pa)"
        )
    clean = quantities.text(truth["clean_friction_rms_N"], FORCE)
    noise = quantities.text(truth["noise_rms_N"], FORCE, ".3g")
    output.say(f"{'friction':<12}{clean} rms, noise {noise} rms")
    output.say(f"{'theory':<12}{truth['theory_nrmse']:.3f} of the std of the clean friction is its error")
    for effect in truth["effects"]:
        output.say(f"{'effect':<12}{effect['spec']}, changes the friction by {effect['size']:.4f} of its rms")
    output.say(f"{'written':<12}{summary['bag']}: {summary['samples']} samples, {summary['duration_s']:g} s")


def _rms(values: Floats) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
