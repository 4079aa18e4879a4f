"""Figures of a replay: the learned curve with its band, and what no data support drawn differently."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.colors import to_rgba

from friction_estimator.core.fit.band import Curve
from friction_estimator.core.online.replay import Replay, replay
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Floats, Samples, joined
from friction_estimator.core.settings.config import Config
from friction_estimator.report import figures, style


def record(n=1500, top=0.1):
    k = np.arange(n)
    velocity = top * np.sin(2 * np.pi * k / 250.0)
    friction = 3.0 * np.tanh(velocity / 0.01)
    return Samples(k * 5_000_000 + 1, velocity, friction, k == 0)


@pytest.fixture(scope="module")
def replayed() -> Replay:
    config = Config.from_mapping(
        {"theory.kind": "seal", "basis.velocity_range": (-0.11, 0.11), "force_unit": 3.0, "model.law": "nlms"}
    )
    return replay(joined([record(), record(1000, 0.05)]), config, starts=(0, 1500))


def band(share: Floats | None, top: float = 0.2) -> Curve:
    v = np.linspace(-top, top, 401)
    f = 3.0 * np.tanh(v / 0.01)
    return Curve(v, f, f - 0.5, f + 0.5, share, pressure_Pa=3.4e5, temperature_degC=54.0)


def drawn_with(replayed: Replay, share: Floats | None = None) -> Replay:
    """Return the replay with a curve learned up to 0.1 m/s and known up to 0.2 m/s."""
    return replace(replayed, curve=band(None, 0.1), outlook=band(share))


def lines(figure):
    return {line.get_label(): line for line in figure.axes[0].get_lines()}


def test_what_no_data_support_is_dashed_and_grey(replayed):
    v = band(None).velocity_m_s
    share = np.where(np.abs(v) < 0.02, 0.2, 0.9)  # the middle was passed too fast, say
    drawn = lines(figures.friction_map(drawn_with(replayed, share), Quantities()))
    known, unknown = drawn["learned"], drawn["learned, no data"]
    assert (known.get_linestyle(), unknown.get_linestyle()) == ("-", "--")
    assert to_rgba(unknown.get_color()) == to_rgba(style.UNSUPPORTED)
    spacing = v[1] - v[0]
    shown = np.isfinite(known.get_ydata())
    assert np.abs(v[shown]).max() <= 0.1 + 2.01 * spacing
    assert np.abs(v[shown]).min() >= 0.02 - 2.01 * spacing
    # Both together show every velocity.
    assert (shown | np.isfinite(unknown.get_ydata())).all()


def test_without_a_share_the_learned_velocities_decide(replayed):
    drawn = lines(figures.friction_map(drawn_with(replayed), Quantities()))
    v = drawn["learned"].get_xdata()
    shown = np.abs(v[np.isfinite(drawn["learned"].get_ydata())])
    assert shown.max() == pytest.approx(0.1, abs=3 * (v[1] - v[0]))
    assert shown.min() == pytest.approx(0.0, abs=1e-9)


def test_the_map_names_units_and_what_it_shows(replayed):
    figure = figures.friction_map(drawn_with(replayed), Quantities())
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("velocity (m/s)", "friction (N)")
    shown = [text.get_text() for text in axes.get_legend().get_texts()]
    assert shown == [
        "measured", "95 % band", "95 % band, no data", "theoretical curve", "Coulomb and viscous, fitted", "learned",
        "learned, no data",
    ]  # fmt: skip


def test_every_figure_is_drawn_for_several_recordings(replayed, tmp_path):
    for one in (replayed, drawn_with(replayed)):
        drawn = figures.write_figures(one, tmp_path)
        assert [path.name for path, _ in drawn] == ["signals.png", "convergence.png", "friction_map.png", "taps.png"]
        assert all(path.stat().st_size > 10_000 for path, _ in drawn)


def test_a_shaft_that_hardly_moves_can_be_drawn(tmp_path):
    n = 200
    rest = Samples(np.arange(n) * 5_000_000 + 1, np.zeros(n), np.sin(np.arange(n)), np.arange(n) == 0)
    config = Config.from_mapping({"theory.kind": "seal", "basis.velocity_range": (-0.1, 0.1), "force_unit": 1.0})
    figures.write_figures(replay(rest, config), tmp_path)
