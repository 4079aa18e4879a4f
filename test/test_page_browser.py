"""The pages in a browser without a network: nothing complains, charts answer to pointer, buttons and keys."""

from pathlib import Path

import numpy as np
import pytest
from browser import Browser, needs_browser, wait
from replays import over

from friction_estimator.cli.main import main
from friction_estimator.core.online.replay import Replay, replay
from friction_estimator.core.quantities import Quantities
from friction_estimator.core.sample import Samples, joined
from friction_estimator.core.settings.config import Config
from friction_estimator.report.page.replay_page import replay_page
from friction_estimator.report.page.write import write_page

pytestmark = needs_browser

RANGE = "[...Bokeh.documents].map((d) => d.get_model_by_name('time')).filter(Boolean).map((r) => [r.start, r.end])[0]"
SAMPLES = "Number(document.querySelector('.explorer').dataset.samples)"
LINES, BAND = ("velocity", "measured", "predicted", "residual"), ("band_low", "band_high")
READOUT = "document.querySelector('.readout').textContent"


def record(n: int, rate: float = 1000.0, period: float = 2.0, gap_s: float = 0.0) -> Samples:
    """A drive of sines with dry friction and noise; a gap in the middle."""
    k = np.arange(n)
    time = k / rate + gap_s * (k >= n // 2)
    velocity = 0.1 * np.sin(2 * np.pi * time / period)
    noise = np.random.default_rng(0).standard_normal(n)
    friction = 3.0 * np.tanh(velocity / 0.005) + 10.0 * velocity + 0.03 * noise
    restart = (k == 0) | ((k == n // 2) & (gap_s > 0.0))
    return Samples((time * 1e9).astype(np.int64) + 1, velocity, friction, restart)


@pytest.fixture(scope="module")
def replayed() -> Replay:
    return replay(joined([record(12_000), record(12_000, gap_s=30.0)]), Config(), starts=(0, 12_000))


def many(result: Replay, times: int) -> Replay:
    """The same recordings over and over: what a long one looks like to a page, without running it."""
    one = result.samples
    n = len(one)
    stamps = (np.arange(n * times) * 1_000_000 + 1).astype(np.int64)
    whole = Samples(
        stamps,
        np.tile(one.velocity_m_s, times),
        np.tile(one.friction_N, times) + np.repeat(np.arange(times), n) * 1e-3,
        np.arange(n * times) % n == 0,
    )
    tiled = {name: np.tile(getattr(result, name), times) for name in ("predicted_N", "learned", "deviation_N")}
    return over(result, samples=whole, starts=(0,), **tiled)


def summary_of(result: Replay, bags=("a",)) -> dict:
    return {"law": "rls", "theory": "seal", "bags": list(bags), **result.figures()}


def written(result: Replay, path, **more):
    scores = [] if result.frozen_score is None else [("the rest", result.frozen_score)]
    write_page(path, replay_page(result, scores, summary_of(result), Quantities(), [], [], [], **more))
    return path


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def page(replayed, tmp_path_factory):
    return written(replayed, tmp_path_factory.mktemp("page") / "report.html")


@pytest.fixture(scope="module")
def long_page(replayed, tmp_path_factory):
    result = many(replayed, 42)
    assert len(result.samples) > 1_000_000
    return written(result, tmp_path_factory.mktemp("long") / "report.html")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("width", [1280, 375])
def test_nothing_complains_and_nothing_hangs_over(browser, page, width, dark):
    browser.open(page, width, dark=dark)
    browser.draw_all()
    assert browser.complaints() == []
    assert browser.js("document.documentElement.scrollWidth") <= width
    assert browser.js("document.querySelectorAll('.plot').length") == browser.js("Bokeh.documents.length")
    # Axis labels have the colour of the page's text, in both.
    ink = browser.js("getComputedStyle(document.documentElement).getPropertyValue('--text').trim()")
    models = "[...Bokeh.documents].flatMap((d) => [...d._all_models.values()])"
    labels = f"{models}.filter((m) => 'axis_label_text_color' in m.properties).map((m) => m.axis_label_text_color)"
    assert set(browser.js(labels)) == {ink}


def test_a_million_samples_stay_small_and_every_view_is_true(browser, long_page, replayed):
    assert long_page.stat().st_size < 5_000_000
    browser.open(long_page)
    browser.draw_all()
    assert browser.complaints() == []
    whole = browser.js(RANGE)
    assert whole[1] - whole[0] == pytest.approx(len(replayed.samples) * 42 / 1000.0, rel=1e-3)
    coarse = browser.js(SAMPLES)
    assert coarse > 100
    # What is drawn holds the largest force of the record, however few points there are.
    highest = "Math.max(...[...Bokeh.documents][0].get_model_by_name('shown').data.measured.filter(Number.isFinite))"
    top = float(np.max(replayed.samples.friction_N)) + 41e-3
    assert browser.js(highest) == pytest.approx(top, abs=2e-3)
    # A cycle that is kept in full is drawn sample by sample.
    browser.js("document.querySelector('[data-act=jump]').click()")
    wait(lambda: browser.js(SAMPLES) == 1, "single samples")
    assert "Every sample" in browser.js("document.querySelector('.grain').textContent")


def test_buttons_keys_wheel_and_pointer_explore(browser, page):
    browser.open(page)
    browser.draw_all()
    start, end = browser.js(RANGE)
    browser.js("document.querySelector('[data-act=in]').click()")
    inner = browser.js(RANGE)
    assert inner[1] - inner[0] == pytest.approx(0.5 * (end - start))
    browser.js("document.querySelector('.explorer').focus()")
    browser.key("ArrowRight")
    moved = browser.js(RANGE)
    assert moved[0] > inner[0]
    browser.key("0")
    assert browser.js(RANGE) == pytest.approx([start, end])
    browser.key(".")
    wait(lambda: "measured" in browser.js(READOUT), "values under the cursor")
    first = browser.js(READOUT)
    browser.key(".")
    assert browser.js(READOUT) != first
    browser.js("document.querySelector('.explorer').scrollIntoView()")
    box = "document.querySelector('.explorer').getBoundingClientRect()"
    at = browser.js(f"[{box}.x + 0.2 * {box}.width, {box}.y + 0.5 * {box}.height]")
    browser.mouse("mouseMoved", *at)
    wait(lambda: browser.js(READOUT) != first, "values under the pointer")
    assert browser.js(READOUT).count(" N") >= 3
    assert "m/s" in browser.js(READOUT)
    browser.mouse("mouseWheel", *at, deltaX=0, deltaY=-240, modifiers=2)  # Ctrl
    wait(lambda: browser.js(RANGE)[1] - browser.js(RANGE)[0] < 0.99 * (end - start), "a zoom by the wheel")
    assert browser.complaints() == []


def test_a_gap_is_a_gap(browser, page):
    browser.open(page)
    browser.draw_all()
    data = "[...Bokeh.documents][0].get_model_by_name('shown').data"
    k = browser.js(f"[...{data}.time_s].findIndex((x, k, t) => t[k + 1] - x > 29)")
    at = [browser.js(f"[...{data}.{name}.slice({k}, {k + 2})].map(String)") for name in LINES]
    assert at == [["NaN", "NaN"]] * len(LINES)
    # A fill goes on over NaN: the band has no height there instead.
    low, high = (browser.js(f"[...{data}.{name}.slice({k}, {k + 2})]") for name in BAND)
    assert low == high
    assert None not in low
    # The cursor in it says so, rather than the value of a neighbour: 30 of the 54 s.
    browser.js("document.querySelector('.explorer').scrollIntoView()")
    box = "document.querySelector('.explorer').getBoundingClientRect()"
    browser.mouse("mouseMoved", *browser.js(f"[{box}.x + 0.6 * {box}.width, {box}.y + 0.5 * {box}.height]"))
    wait(lambda: "nothing was recorded" in browser.js(READOUT), "the word for a gap")


@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
def test_charts_are_pictures_on_paper(browser, page, dark):
    """A chart that is drawn for a screen would be cut at the sheet's edge, and pale where the screen was dark."""
    browser.open(page, 1280, dark=dark)
    browser.draw_all()
    for rows in (30, 500):
        table = f"<details id=rows-{rows}><table>{'<tr><td>1' * rows}</table></details>"
        browser.js(f"document.querySelector('main').insertAdjacentHTML('beforeend', '{table}')")
    # As a browser does that prints: the event first, then the sheet, which is light.
    browser.js("window.dispatchEvent(new Event('beforeprint'))")
    scheme = {"name": "prefers-color-scheme", "value": "light"}
    browser.call("Emulation.setEmulatedMedia", media="print", features=[scheme])
    browser.call("Emulation.setDeviceMetricsOverride", width=700, height=1000, deviceScaleFactor=1, mobile=False)
    assert browser.js("[30, 500].map((n) => document.getElementById(`rows-${n}`).open)") == [True, False]
    plots = "[...document.querySelectorAll('.plot')]"
    seen = f"{plots}.map((plot) => [...plot.children].filter((one) => one.getClientRects().length))"
    count = browser.js(f"{plots}.length")
    assert browser.js(f"{seen}.map((them) => them.map((one) => one.tagName))") == [["CANVAS"]] * count
    assert browser.js(f"Math.max(...{seen}.map(([one]) => one.getBoundingClientRect().right))") <= 700
    inked = "one.getContext('2d').getImageData(0, 0, one.width, one.height).data.some((x) => x > 0)"
    assert browser.js(f"{seen}.every(([one]) => {inked})")
    inverted = browser.js(f"{seen}.map(([one]) => getComputedStyle(one).filter.startsWith('invert'))")
    assert inverted == [dark] * count
    assert browser.js("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    browser.js("window.dispatchEvent(new Event('afterprint'))")
    browser.call("Emulation.setEmulatedMedia", media="screen")
    assert browser.js("document.querySelectorAll('.printed').length") == 0
    assert browser.complaints() == []


def test_a_hostile_name_stays_text(browser, replayed, tmp_path):
    evil = "</script><img src=x onerror=document.title='broken'>$$x$$\x1b[2J\u202e"
    result = replayed
    made = replay_page(result, [], summary_of(result, [evil]), Quantities(), [], [], [])
    write_page(tmp_path / "report.html", made)
    browser.open(tmp_path / "report.html")
    browser.draw_all()
    assert browser.complaints() == []
    assert browser.js("document.title") == "Friction estimated"
    assert "onerror" in browser.js("document.querySelector('.lead').textContent")
    assert browser.js("document.querySelectorAll('img').length") == 0


def test_a_diagnosis_tells_its_cause_and_shows_it(browser, tmp_path):
    bag = Path(__file__).parents[1] / "bags" / "crank_inertia"
    settings = tmp_path / "seal.yaml"
    settings.write_text("/**:\n  ros__parameters:\n    theory: {kind: seal}\n")
    assert main(["diagnose", str(bag), "--config", str(settings), "--out", str(tmp_path / "out")]) == 0
    browser.open(tmp_path / "out" / "report.html", 375)
    browser.draw_all()
    assert browser.complaints() == []
    assert browser.js("document.documentElement.scrollWidth") <= 375
    card = "document.querySelector('.card')"
    assert browser.js(f"{card}.querySelector('code').textContent") == "inertia"
    assert "kg" in browser.js(f"{card}.querySelector('.facts').textContent")
    # The bar is as long as the gain that the text says, within its interval.
    bar = float(browser.js(f"{card}.querySelector('.bar').getAttribute('width')"))
    low = float(browser.js(f"{card}.querySelector('.interval').getAttribute('x')"))
    assert low < bar < 100.0
    assert f"by {bar:.1f} %" in browser.js(f"{card}.querySelector('.gain').textContent")
    for name in ("before_left", "after_left"):
        assert browser.js(f"[...Bokeh.documents].filter((d) => d.get_model_by_name('{name}')).length") == 1
    # What was looked for is there when it is asked for.
    browser.js("document.querySelector('details').open = true")
    assert "Sensor bias" in browser.js("document.querySelector('details').innerText")
