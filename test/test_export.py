"""Exports give what was learned: the C header to rounding, robot descriptions within what they can say."""

import csv
import ctypes
import json
import re
import shutil
import subprocess
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from blank_drawings import blank_drawings as drawn_blank

from friction_estimator.cli.main import main
from friction_estimator.core.errors import ConfigError, UnanswerableError
from friction_estimator.core.fit.baselines import StaticCurve
from friction_estimator.core.online.estimator import Estimator
from friction_estimator.core.online.first_contact import chosen
from friction_estimator.core.sample import Samples
from friction_estimator.core.settings.config import Config
from friction_estimator.export import FORMATS
from friction_estimator.export.learned import Learned
from friction_estimator.export.simplified import coulomb_viscous, curve_with_intervals

pytestmark = pytest.mark.xdist_group("export")

COMPILER = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")

CALLS = """
#include "friction_model.h"
void run(int n, const double *velocity, const double *pressure, const double *temperature, const unsigned char *restart,
         double *predicted)
{
    friction_model_state state;
    friction_model_reset(&state);
    for (int k = 0; k < n; ++k) {
        if (restart[k]) friction_model_reset(&state);
        predicted[k] = friction_model_step(&state, velocity[k], pressure[k], temperature[k]);
    }
}
double at(double velocity) { return friction_model_static(velocity, NAN, NAN); }
"""


def drive(seed=0, n=6000, rate=500):
    """A drive with everything that the header has to follow: gaps, unknown pressure, speeds beyond the range."""
    rng = np.random.default_rng(seed)
    time = np.arange(n) / rate
    velocity = 0.1 * np.sin(2 * np.pi * 0.9 * time) + 0.02 * np.sin(2 * np.pi * 0.313 * time)
    friction = 4.0 * np.tanh(velocity / 0.003) + 12.0 * velocity + 0.02 * rng.standard_normal(n)
    restart = np.zeros(n, np.bool_)
    restart[[0, n // 3, n // 2]] = True
    pressure = np.where(time < 4.0, np.nan, 101325.0 + 2e5 * (1.0 + np.sin(time)))
    return Samples(
        stamp_ns=(time * 1e9).astype(np.int64) + 1,
        velocity_m_s=velocity,
        friction_N=friction,
        restart=restart,
        pressure_Pa=pressure,
        temperature_degC=np.where(time < 2.0, np.nan, 40.0 + time),
    )


def learned_from(samples, **settings):
    config = Config.from_mapping(
        {"theory.kind": "seal", "basis.velocity_range": [-0.1, 0.1], "force_unit": 4.0, **settings}
    )
    estimator = Estimator(chosen(config, samples))
    estimator.run(samples)
    return Learned("out", estimator.learned_config, samples=samples, recordings=["drive"])


@pytest.fixture
def compiled(tmp_path):
    """Return the functions of a header, compiled with every warning an error."""
    if COMPILER is None:
        pytest.skip("no C compiler is here: the header is not compiled")

    def build(text):
        (tmp_path / "friction_model.h").write_text(text)
        (tmp_path / "calls.c").write_text(CALLS)
        strict = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
        made = tmp_path / "calls.so"
        subprocess.run(
            [COMPILER, *strict, "-O2", "-shared", "-fPIC", "-o", made, tmp_path / "calls.c", "-lm"], check=True
        )
        return ctypes.CDLL(str(made))

    return build


def run(library, samples):
    double = np.ctypeslib.ndpointer(np.float64, flags="C")
    flags = np.ctypeslib.ndpointer(np.uint8, flags="C")
    library.run.argtypes = [ctypes.c_int, double, double, double, flags, double]
    out = np.empty(len(samples))
    library.run(
        len(samples),
        samples.velocity_m_s,
        samples.pressure_Pa,
        samples.temperature_degC,
        samples.restart.astype(np.uint8),
        out,
    )
    return out


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"model.type": "hammerstein"},
        {"basis.wavelet": "db1", "basis.companding": 0.0},
        {"basis.wavelet": "db5", "fir.order": 0, "basis.velocity_range": [-0.03, 0.2]},
        {"theory.kind": "none", "model.type": "hammerstein", "fir.order": 3},
        {"seal.asymmetry": 0.3, "theory.ambient_pressure": 9e4},
        {"theory.kind": "stribeck"},
        {
            "theory.kind": "stribeck",
            "stribeck.coulomb": [2.0, 3.0],
            "stribeck.breakaway": [1.0],
            "stribeck.exponent": 2.0,
        },
    ],
    ids=["parallel", "hammerstein", "haar", "db5", "no theory", "asymmetric seal", "stribeck", "given stribeck"],
)
def test_the_c_header_predicts_as_the_node_does(settings, compiled):
    samples = drive()
    learned = learned_from(samples, **settings)
    # Judged where it has not been: half as fast again, so the range is left too.
    faster = replace(drive(seed=1), velocity_m_s=1.5 * drive(seed=1).velocity_m_s)
    library = compiled(FORMATS["c"].write(learned).text)
    predicted = Estimator(learned.config).run(faster, learn=False)
    assert np.max(np.abs(run(library, faster) - predicted)) < 1e-9
    library.at.restype, library.at.argtypes = ctypes.c_double, [ctypes.c_double]
    curve = learned.estimator.curve()
    static = [library.at(velocity) for velocity in curve.velocity_m_s]
    assert np.max(np.abs(static - curve.friction_N)) < 1e-9
    assert np.isnan(library.at(float("nan")))


def test_a_velocity_that_is_no_number_does_not_poison_the_header(compiled):
    samples = drive(n=300)
    broken = replace(samples, velocity_m_s=samples.velocity_m_s.copy())
    broken.velocity_m_s[100] = np.inf
    library = compiled(FORMATS["c"].write(learned_from(drive())).text)
    out = run(library, broken)
    assert np.isnan(out[100])
    assert np.isfinite(np.delete(out, 100)).all()


def test_a_header_of_terms_or_tables_is_refused_with_the_way_out():
    class Terms:
        size, names = 1, ("inertia",)
        forces = phases = np.zeros(1, np.bool_)

        def columns(self, samples, theory_N):
            return samples.velocity_m_s[:, None]

        def restart(self):
            pass

    learned = learned_from(drive())
    config = learned.config.updated({"learned.extension_weights": [1.0], "extension.terms": ["inertia"]})
    with pytest.raises(ConfigError, match=r"inertia.*--format csv"):
        FORMATS["c"].write(Learned("out", config, Terms()))


def test_parameters_are_those_of_the_drive_and_their_intervals_hold_them():
    true = {"coulomb_pos_N": 4.0, "viscous_pos_N_s_m": 12.0, "coulomb_neg_N": 3.0, "viscous_neg_N_s_m": 20.0}
    true |= {"stribeck_pos_N": 2.0, "stribeck_neg_N": 1.0, "width_m_s": 0.001, "stribeck_m_s": 0.02}
    true["stribeck_exponent"] = 2.0
    samples = drive()
    clean = StaticCurve("stribeck_asymmetric", true).evaluate(samples.velocity_m_s)
    base, held = learned_from(samples), 0
    for seed in range(3):
        noise = 0.05 * np.random.default_rng(seed).standard_normal(len(samples))
        learned = replace(base, samples=replace(samples, friction_N=clean + noise))
        _, intervals = curve_with_intervals(learned, "stribeck_asymmetric")
        held += sum(intervals[name].low <= value <= intervals[name].high for name, value in true.items())
        assert all(i.high - i.low < 0.2 * abs(i.value) + 1e-12 for i in intervals.values())
    assert held >= 23  # of 27; 95 % are 25.6
    document = json.loads(FORMATS["json"].write(learned).text)
    assert document["directions"]["negative"]["coulomb_N"]["value"] == intervals["coulomb_neg_N"].value
    assert document["directions"]["error_rms_N"] < 0.06 < document["coulomb_viscous"]["error_rms_N"]


def test_a_direction_that_is_not_driven_has_no_parameters():
    samples = drive()
    one_way = replace(samples, velocity_m_s=np.abs(samples.velocity_m_s), friction_N=np.abs(samples.friction_N))
    with pytest.raises(UnanswerableError, match="one direction"):
        FORMATS["json"].write(learned_from(one_way))


def test_friction_that_falls_with_speed_is_no_negative_damping_and_the_file_says_what_it_costs():
    samples = drive()
    falling = 4.0 * np.tanh(samples.velocity_m_s / 0.001) - 20.0 * samples.velocity_m_s
    learned = learned_from(replace(samples, friction_N=falling))
    found = coulomb_viscous(learned)
    assert found.viscous_N_s_m == 0.0
    assert found.error_rms_N > 3.0 * learned.static_error_rms_N()
    text = FORMATS["urdf"].write(learned).text
    assert "TOO SIMPLE" in text
    assert "falls with speed" in text


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A drive of 10 N and 60 N s/m as a table, imported, learned, and exported in every format."""
    folder = tmp_path_factory.mktemp("export")
    rng = np.random.default_rng(5)
    time = np.arange(10_000) / 500
    velocity = 0.2 * np.sin(2 * np.pi * 0.7 * time) + 0.05 * np.sin(2 * np.pi * 0.23 * time)
    friction = 10.0 * np.tanh(velocity / 5e-4) + 60.0 * velocity + 0.1 * rng.standard_normal(time.size)
    np.savetxt(
        folder / "table.csv", np.column_stack([time, velocity, friction]), delimiter=",", header="t,v,f", comments=""
    )
    mapped = ["--time", "t", "--map", "velocity=v,friction=f"]
    assert main(["import", str(folder / "table.csv"), "--out", str(folder / "bag"), *mapped]) == 0
    with drawn_blank():
        assert main(["replay", str(folder / "bag"), "--out", str(folder / "run")]) == 0
    for name in FORMATS:
        out = str(folder / f"model.{name}")
        assert main(["export", str(folder / "run"), "--format", name, "--out", out]) == 0
    return folder


def test_the_table_is_the_curve_with_the_band_of_the_run(exported):
    with (exported / "model.csv").open() as lines:
        rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    curve = json.loads((exported / "run" / "summary.json").read_text())["curve"]
    for column in ("velocity_m_s", "friction_N", "low_N", "high_N"):
        assert [float(row[column]) for row in rows] == curve[column]


def test_every_format_says_what_it_costs(exported):
    for name in set(FORMATS) - {"json"}:
        text = (exported / f"model.{name}").read_text()
        this, whole, spread = map(
            float,
            re.findall(r"this file (\S+) N, the whole model.* (\S+) N;\s.*by (\S+) N", text.replace("\n", " "))[0],
        )
        assert 0.09 < whole <= 1.01 * this < 0.5 < spread


def test_the_urdf_element_stands_in_a_joint(exported):
    element = ElementTree.parse(exported / "model.urdf").getroot()
    assert element.tag == "dynamics"
    assert float(element.get("friction")) == pytest.approx(10.0, rel=0.02)
    assert float(element.get("damping")) == pytest.approx(60.0, rel=0.05)
    mujoco = pytest.importorskip("mujoco")
    robot = f"""<robot name="rig"><link name="base"/><link name="shaft"><inertial><mass value="2"/>
      <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="j" type="prismatic"><parent link="base"/><child link="shaft"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="100" velocity="1"/>{(exported / "model.urdf").read_text()}</joint></robot>"""
    model = mujoco.MjModel.from_xml_string(robot)
    assert model.dof_frictionloss[0] == pytest.approx(float(element.get("friction")))
    assert model.dof_damping[0] == pytest.approx(float(element.get("damping")))


@pytest.fixture(scope="module")
def simulated(exported):
    """The exported class in a model of a sliding mass of 2 kg."""
    mujoco = pytest.importorskip("mujoco")
    (exported / "rig.xml").write_text(
        f"""<mujoco><option timestep="0.0005" gravity="0 0 0"/><include file="model.mjcf"/><worldbody><body>
        <joint class="learned_friction" name="shaft" type="slide" axis="1 0 0"/><geom size="0.1" mass="{MASS}"/>
        </body></worldbody><actuator><motor joint="shaft"/></actuator></mujoco>"""
    )
    model = mujoco.MjModel.from_xml_path(str(exported / "rig.xml"))
    return mujoco, model


MASS = 2.0


def test_a_mass_coasts_down_in_mujoco_as_on_the_drive(simulated):
    mujoco, model = simulated
    data = mujoco.MjData(model)
    data.qvel[0] = 0.25
    while data.qvel[0] > 1e-4 and data.time < 1.0:
        mujoco.mj_step(model, data)
    # m v' = -Fc - Fv v from v0 to rest: t = m/Fv ln(1 + Fv v0/Fc), x = m/Fv (v0 - Fc/Fv ln(1 + Fv v0/Fc)).
    coulomb, viscous, speed = 10.0, 60.0, 0.25
    log = np.log1p(viscous * speed / coulomb)
    assert data.time == pytest.approx(MASS / viscous * log, rel=0.1)
    assert data.qpos[0] == pytest.approx(MASS / viscous * (speed - coulomb / viscous * log), rel=0.1)


def test_a_mass_below_breakaway_stays_in_mujoco(simulated):
    mujoco, model = simulated
    data = mujoco.MjData(model)
    data.ctrl[0] = 9.0
    while data.time < 1.0:
        mujoco.mj_step(model, data)
    travel = 0.12  # peak to peak of the drive, about m
    assert abs(data.qpos[0]) < 1e-5 * travel
    data.ctrl[0] = 12.0  # and above it moves
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    assert data.qpos[0] > 1e-3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["run", "--format", "stl"], "invalid choice"),
        (["missing", "--format", "csv"], "missing"),
        (["bag", "--format", "csv"], "no config.yaml"),
        (["cold.yaml", "--format", "csv"], "no learned model"),
        (["elsewhere/alone.yaml", "--format", "urdf"], "--recording"),
    ],
)
def test_a_wrong_use_is_one_line(exported, arguments, said, capsys):
    (exported / "elsewhere").mkdir(exist_ok=True)
    (exported / "cold.yaml").write_text("/**:\n  ros__parameters:\n    fir.order: 4\n")
    shutil.copy(exported / "run" / "config.yaml", exported / "elsewhere" / "alone.yaml")
    try:
        code = main(["export", str(exported / arguments[0]), *arguments[1:]])
    except SystemExit as left:
        code = left.code
    captured = capsys.readouterr()
    assert code == 2
    assert said in captured.err
    assert captured.err.count("\n") == 1
    assert captured.out == ""


def test_without_a_recording_the_cost_is_not_known_and_the_band_is_empty(exported, capsys):
    (exported / "elsewhere").mkdir(exist_ok=True)
    shutil.copy(exported / "run" / "config.yaml", exported / "elsewhere" / "alone.yaml")
    assert main(["export", str(exported / "elsewhere" / "alone.yaml"), "--format", "csv"]) == 0
    text = capsys.readouterr().out
    assert "not measured" in text
    assert text.splitlines()[-1].endswith(",,")
    judged = ["--recording", str(exported / "bag")]
    assert main(["export", str(exported / "elsewhere" / "alone.yaml"), "--format", "urdf", *judged]) == 0
    assert "<dynamics" in capsys.readouterr().out
