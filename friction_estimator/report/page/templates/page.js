// The page's own part: draws each chart when it comes into sight, colours it as the page, and lets signals be explored.
"use strict";
(() => {
  const MOST_ROWS = 4000; // of a table that are drawn at a time: two to a pixel of a wide screen
  const MOST_PRINTED = 60; // rows of a folded table that are printed; who wants a longer one on paper opens it
  const INKS = ["line_color", "fill_color", "text_color", "hatch_color"];
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const drawn = new Map(); // name of a chart -> its view
  const explorers = [];

  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
  const entries = (map) => (map instanceof Map ? [...map.entries()] : Object.entries(map));
  const column = (source, name) => (source.data instanceof Map ? source.data.get(name) : source.data[name]);
  const set = (model, name, value) => { if (name in model.properties) model[name] = value; };

  function dress(doc) {
    document.documentElement.dataset.painted = dark.matches ? "dark" : "light";
    const text = colour("text"), quiet = colour("quiet"), rule = colour("rule");
    for (const model of doc._all_models?.values() ?? doc.all_models) {
      for (const tag of model.tags) {
        if (typeof tag === "string" && tag.startsWith("ink:")) {
          for (const name of INKS) if (name in model.properties && model[name] != null) model[name] = colour(tag.slice(4));
        }
      }
      for (const name of ["axis_label_text_color", "label_text_color", "title_text_color"]) set(model, name, text);
      for (const name of ["major_label_text_color", "axis_line_color", "major_tick_line_color"]) set(model, name, quiet);
      for (const name of ["grid_line_color", "outline_line_color"]) set(model, name, rule);
      if (model.type === "ColorBar") model.setv({ bar_line_color: rule, visible: innerWidth >= 700 });
      if (model.type === "Figure" || model.type === "Plot") for (const legend of model.above) if (legend.type === "Legend") fold(model, legend);
    }
  }

  // A row of names would hang over the edge of a phone: they stand below each other there, and the chart is as much
  // higher, or its names would leave no room for its lines.
  const heights = new WeakMap();
  function fold(plot, legend) {
    if (!heights.has(plot)) heights.set(plot, plot.height);
    const narrow = innerWidth < 700, many = legend.items.length;
    const columns = legend.items.every((item) => (item.label.value ?? "").length < 8) ? 3 : 1;
    legend.setv(narrow ? { orientation: "vertical", ncols: columns, nrows: "auto" } : { orientation: "horizontal", ncols: "auto", nrows: "auto" });
    plot.height = heights.get(plot) + (narrow ? 20 * (Math.ceil(many / columns) - 1) : 0);
  }

  async function draw(place) {
    if (drawn.has(place.id)) return;
    drawn.set(place.id, null);
    const item = JSON.parse(document.getElementById(place.id + "-data").textContent);
    item.target_id = place.id;
    // Of its own view: several charts are drawn at a time, and any of them may be the last of `Bokeh.documents`.
    const [view] = await Bokeh.embed.embed_item(item);
    const doc = view.model.document;
    drawn.set(place.id, view);
    dress(doc);
    if (place.classList.contains("explorer")) explorers.push(explore(place, doc));
    place.dataset.drawn = "yes";
  }

  // ---- signals over time ----

  // A table as plain numbers: for each signal its low and high, the same array where rows are samples.
  function unpacked(source) {
    const { steps, samples } = source.tags[0];
    const known = entries(source.data).map(([name]) => name);
    const signals = {};
    const values = (name, zero, step) => {
      const raw = column(source, name), out = new Float64Array(raw.length);
      for (let k = 0; k < raw.length; k++) out[k] = raw[k] === -32768 ? NaN : zero + step * raw[k];
      return out;
    };
    for (const name of known) {
      if (name === "time_s" || name === "gap") continue;
      const signal = name.replace(/_(low|high)$/, "");
      const of = signal in steps ? signal : name; // `band_low` is a signal of its own
      if (name in steps || !(of in steps)) {
        if (!(name in steps)) signals[name] = { low: column(source, name), high: column(source, name) };
      } else if (name.endsWith("_low")) {
        signals[of] = { low: values(name, ...steps[of]), high: values(of + "_high", ...steps[of]) };
      }
    }
    return { time: column(source, "time_s"), gap: column(source, "gap"), signals, samples };
  }

  // Every two rows as one; none reaches over a gap.
  function coarser(table) {
    const begins = [];
    let inside = 0;
    for (let k = 0; k < table.time.length; k++) {
      if (k === 0 || table.gap[k] || inside === 2) { begins.push(k); inside = 0; }
      inside++;
    }
    begins.push(table.time.length);
    const n = begins.length - 1;
    const out = { time: new Float64Array(n), gap: new Uint8Array(n), signals: {}, samples: 2 * table.samples };
    for (let i = 0; i < n; i++) { out.time[i] = table.time[begins[i]]; out.gap[i] = table.gap[begins[i]]; }
    for (const [name, { low, high }] of Object.entries(table.signals)) {
      const lows = new Float64Array(n), highs = new Float64Array(n);
      for (let i = 0; i < n; i++) {
        let least = Infinity, most = -Infinity;
        for (let k = begins[i]; k < begins[i + 1]; k++) {
          if (low[k] < least) least = low[k];
          if (high[k] > most) most = high[k];
        }
        lows[i] = least === Infinity ? NaN : least;
        highs[i] = most === -Infinity ? NaN : most;
      }
      out.signals[name] = { low: lows, high: highs };
    }
    return out;
  }

  function place_of(time, seconds) { // of the last row at or before `seconds`
    let low = 0, high = time.length;
    while (low < high) { const middle = (low + high) >> 1; if (time[middle] <= seconds) low = middle + 1; else high = middle; }
    return low - 1;
  }

  function explore(place, doc) {
    const stores = entries(doc.get_model_by_name("stores").args).sort(([a], [b]) => (a < b ? -1 : 1)).map(([, s]) => unpacked(s));
    const shown = doc.get_model_by_name("shown"), range = doc.get_model_by_name("time");
    const panels = ["velocity", "friction", "residual"].map((name) => doc.get_model_by_name(name));
    const cursors = panels.map((panel) => doc.get_model_by_name("cursor_" + panel.name));
    const levels = [stores[0]], close = stores.slice(1);
    while (levels[levels.length - 1].time.length > MOST_ROWS) {
      const next = coarser(levels[levels.length - 1]);
      if (next.time.length >= levels[levels.length - 1].time.length) break;
      levels.push(next);
    }
    const first = stores[0].time[0], last = stores[0].time[stores[0].time.length - 1];
    const readout = document.getElementById(place.id + "-readout"), grain = document.getElementById(place.id + "-grain");
    const lines = { velocity: ["velocity"], friction: ["measured", "predicted", "predicted_0"], residual: ["residual", "residual_0"] };
    const units = panels.map((panel) => (/\(([^)]*)\)/.exec(doc.get_model_by_name(panel.name).left[0].axis_label) || ["", ""])[1]);
    const usual = (last - first) / Math.max(1, stores[0].time.length - 1);
    let table = levels[0], at = NaN;

    function chosen(start, stop) {
      for (const one of close) if (start >= one.time[0] - 1e-9 && stop <= one.time[one.time.length - 1] + 1e-9) return one;
      for (const one of levels) if (place_of(one.time, stop) - place_of(one.time, start) <= MOST_ROWS) return one;
      return levels[levels.length - 1];
    }

    function show() {
      const { start, end } = range;
      table = chosen(start, end);
      const from = Math.max(0, place_of(table.time, start) - 1);
      const to = Math.min(table.time.length, place_of(table.time, end) + 3);
      const full = table.samples === 1, time = [], rows = [];
      for (let k = from; k < to; k++) {
        // A fill does not end at NaN as a line does: in a gap the band is a line of no height from one end to the other.
        if (table.gap[k] && k > from) { time.push(table.time[k - 1], table.time[k]); rows.push(-k, -k); }
        time.push(table.time[k]); rows.push(k);
        if (!full) { time.push(table.time[k]); rows.push(k); }
      }
      const data = { time_s: Float64Array.from(time) };
      for (const [name, { low, high }] of Object.entries(table.signals)) {
        const values = new Float64Array(rows.length);
        const one_sided = name === "band_low" ? low : name === "band_high" ? high : null;
        let second = false;
        for (let i = 0; i < rows.length; i++) {
          second = !full && i > 0 && rows[i] === rows[i - 1];
          if (rows[i] < 0) values[i] = one_sided ? centre(table.signals, rows[i + 1] === rows[i] ? -rows[i] - 1 : -rows[i]) : NaN;
          else values[i] = one_sided ? one_sided[rows[i]] : second ? high[rows[i]] : low[rows[i]];
        }
        data[name] = values;
      }
      shown.data = data;
      for (const panel of panels) fit(panel, from, to);
      grain.textContent = full ? "Every sample is drawn."
        : `Each step of the lines is the lowest and the highest of up to ${table.samples} samples; zoom in, or take one of the cycles, for every sample.`;
      place.dataset.samples = table.samples;
    }

    const centre = ({ band_low, band_high }, row) => (band_low.low[row] + band_high.high[row]) / 2;

    function fit(panel, from, to) {
      let least = Infinity, most = -Infinity;
      for (const name of lines[panel.name]) {
        const signal = table.signals[name];
        if (!signal) continue;
        for (let k = Math.max(0, from + 1); k < to; k++) {
          if (signal.low[k] < least) least = signal.low[k];
          if (signal.high[k] > most) most = signal.high[k];
        }
      }
      if (!(least <= most)) return;
      const room = 0.06 * (most - least) || Math.abs(most) * 0.1 || 1;
      panel.y_range.setv({ start: least - room, end: most + room });
    }

    const limited = (start, stop) => {
      const least = 8 * (last - first) / Math.max(8, stores[0].time.length * stores[0].samples);
      const width = Math.min(last - first, Math.max(least, stop - start));
      const middle = Math.min(last - width / 2, Math.max(first + width / 2, (start + stop) / 2));
      range.setv({ start: middle - width / 2, end: middle + width / 2 });
    };
    const zoom = (factor) => {
      const middle = at >= range.start && at <= range.end ? at : (range.start + range.end) / 2;
      limited(middle - (middle - range.start) * factor, middle + (range.end - middle) * factor);
    };
    const move = (share) => { const step = share * (range.end - range.start); limited(range.start + step, range.end + step); };

    const number = (x) => (Number.isFinite(x) ? String(+x.toPrecision(4)) : "none");
    function point(seconds) {
      const k = Math.min(table.time.length - 1, Math.max(0, place_of(table.time, seconds)));
      const next = Math.min(table.time.length - 1, k + 1);
      if (table.gap[next] && next > k && seconds > table.time[k] + 2 * usual && seconds < table.time[next]) {
        readout.textContent = `${seconds.toFixed(4)} s  ·  nothing was recorded here`;
        for (const cursor of cursors) cursor.location = seconds;
        at = seconds;
        return;
      }
      const row = table.samples === 1 && Math.abs(table.time[next] - seconds) < Math.abs(table.time[k] - seconds) ? next : k;
      at = table.time[row];
      for (const cursor of cursors) cursor.location = at;
      const word = (name, unit) => {
        const signal = table.signals[name];
        if (!signal) return "";
        const a = signal.low[row], b = signal.high[row];
        return a === b || (Number.isNaN(a) && Number.isNaN(b)) ? `${number(a)} ${unit}` : `${number(a)} to ${number(b)} ${unit}`;
      };
      const parts = [`${at.toFixed(4)} s`, `velocity ${word("velocity", units[0])}`, `measured ${word("measured", units[1])}`];
      if (table.signals.predicted_0) parts.push(`before ${word("predicted_0", units[1])}`);
      parts.push(`predicted ${word("predicted", units[1])}`);
      if (table.signals.band_low) {
        parts.push(`95 % band ${number(table.signals.band_low.low[row])} to ${number(table.signals.band_high.high[row])} ${units[1]}`);
      }
      parts.push(`measured - predicted ${word("residual", units[2])}`);
      readout.textContent = parts.join("  ·  ");
    }
    const step = (way) => {
      const k = Number.isNaN(at) ? place_of(table.time, (range.start + range.end) / 2) : place_of(table.time, at) + way;
      const row = Math.min(table.time.length - 1, Math.max(0, k));
      point(table.time[row]);
      if (at < range.start || at > range.end) limited(at - (range.end - range.start) / 2, at + (range.end - range.start) / 2);
    };

    let waiting = false;
    range.change.connect(() => {
      if (waiting) return;
      waiting = true;
      requestAnimationFrame(() => { waiting = false; show(); });
    });
    for (const panel of panels) {
      panel.on_event("mousemove", (event) => point(event.x));
      panel.on_event("reset", () => limited(first, last));
    }
    const acts = {
      all: () => limited(first, last), in: () => zoom(0.5), out: () => zoom(2), back: () => move(-0.5), on: () => move(0.5),
    };
    for (const button of place.parentElement.querySelectorAll("button[data-act]")) {
      button.addEventListener("click", () => {
        if (button.dataset.act === "jump") limited(Number(button.dataset.start), Number(button.dataset.stop));
        else acts[button.dataset.act]();
      });
    }
    const keys = {
      ArrowLeft: () => move(-0.2), ArrowRight: () => move(0.2), "+": acts.in, "=": acts.in, "-": acts.out, 0: acts.all,
      Home: acts.all, ".": () => step(1), ",": () => step(-1),
    };
    place.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || !(event.key in keys)) return;
      event.preventDefault();
      keys[event.key]();
    });
    show();
    return { show };
  }

  // ---- when to draw ----

  const places = [...document.querySelectorAll(".plot")];
  const near = new IntersectionObserver((seen) => {
    for (const one of seen) if (one.isIntersecting) { near.unobserve(one.target); draw(one.target); }
  }, { rootMargin: "600px" });
  // The words are painted before the first chart is made.
  requestAnimationFrame(() => setTimeout(() => {
    for (const place of places) near.observe(place);
    const idle = window.requestIdleCallback || ((work) => setTimeout(work, 300));
    const rest = () => {
      const next = places.find((place) => !drawn.has(place.id) && place.getClientRects().length);
      if (next) draw(next).then(() => idle(rest));
      else document.documentElement.dataset.drawn = "all";
    };
    idle(rest);
  }, 0));
  // Paper is light: a browser that prints says so, too, but what is drawn for it now would be on the screen, and late.
  dark.addEventListener("change", () => {
    if (!matchMedia("print").matches) for (const view of drawn.values()) if (view) dress(view.model.document);
  });
  for (const one of document.querySelectorAll("details")) {
    one.addEventListener("toggle", () => one.querySelectorAll(".plot").forEach((place) => { if (one.open) draw(place); }));
  }

  // ---- on paper ----

  // A chart would learn of the sheet's width and colours after it is printed: a picture of it, which takes any width,
  // stands for it. One that was drawn for a dark page is printed inverted (page.css).
  addEventListener("beforeprint", () => {
    for (const one of document.querySelectorAll("details")) {
      if (one.querySelectorAll("tr").length <= MOST_PRINTED) one.open = true;
    }
    for (const [name, view] of drawn) {
      if (!view) continue;
      const { canvas } = view.export("png", false);
      canvas.className = "printed";
      document.getElementById(name).append(canvas);
    }
  });
  addEventListener("afterprint", () => document.querySelectorAll(".printed").forEach((one) => one.remove()));
})();
