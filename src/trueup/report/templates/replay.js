// The replay figure: recording, command, before and after, with the error beneath on the same time axis.

const shown = { replay: DATA.start[0], column: DATA.start[1] };

function linesOf(replay, series) {
  const measured = column(series.measured);
  return {
    time: scaled(column(series.time), 1, replay.origin),
    measured: measured,
    before: plus(measured, column(series.before)),
    after: plus(measured, column(series.after)),
    command: series.command ? column(series.command) : null,
    errorBefore: scaled(column(series.before), replay.errorFactor),
    errorAfter: scaled(column(series.after), replay.errorFactor),
  };
}

function line(name, x, y, colour, more) {
  return Object.assign({
    type: "scatter", mode: "lines", name: name, x: x, y: gaps(y), connectgaps: false,
    line: { color: colour, width: 1.5 }, hovertemplate: "%{y:.4f}",
  }, more);
}

function replayTraces(replay, lines) {
  const p = palette();
  const traces = [];
  if (lines.command) {
    traces.push(line("command", lines.time, lines.command, p.command,
      { line: { color: p.command, width: 1, dash: "4px,3px", shape: "hv" } }));
  }
  traces.push(line("measured", lines.time, lines.measured, p.measured, { line: { color: p.measured, width: 1.9 } }));
  const compared = lines.before.some((v) => Number.isFinite(v));
  if (compared) traces.push(line("before", lines.time, lines.before, p.before, { line: { color: p.before, width: 1.3 } }));
  traces.push(line("after", lines.time, lines.after, p.after));
  const unit = plain(replay.errorUnit);
  for (const [name, y, colour] of [["before", lines.errorBefore, p.before], ["after", lines.errorAfter, p.after]]) {
    traces.push(line(name, lines.time, y, colour, {
      yaxis: "y2", showlegend: false, line: { color: colour, width: 1.2 },
      hovertemplate: "%{y:.3~f} " + unit.replace(/[%{}]/g, ""),
    }));
  }
  return traces;
}

// A simulation that ran away must not flatten the rest: 'before' may at most double the range.
function valueRange(lines) {
  const main = range([lines.measured, lines.after, lines.command || []].map(calm));
  const all = range([lines.measured, lines.before, lines.after, lines.command || []]);
  if (!main || !all) return null;
  const size = main[1] - main[0] || Math.abs(main[0]) * 0.01 || 1;
  const low = Math.max(all[0], main[0] - size / 2), high = Math.min(all[1], main[1] + size / 2);
  const span = high - low || size;
  return [low - 0.05 * span, high + 0.05 * span];
}

// without the few values that are a hundred times larger than nearly all others
function calm(values) {
  const limit = 100 * quantile(values, 0.95);
  return limit > 0 ? Float64Array.from(values).filter((v) => Math.abs(v) <= limit) : values;
}

function errorRange(lines, noise) {
  const typical = 15 * Math.max(quantile(lines.errorAfter, 0.99), 2 * noise) || Infinity;
  const largest = Math.max(Math.min(quantile(lines.errorBefore, 1), typical), quantile(lines.errorAfter, 0.9999), 2 * noise);
  return [-1.08 * largest || -1, 1.08 * largest || 1];
}

function replayShapes(replay, series) {
  const p = palette(), shapes = [], box = { type: "rect", layer: "below", line: { width: 0 } };
  if (series.noise) {
    const noise = 2 * series.noise * replay.errorFactor;
    shapes.push({ ...box, xref: "paper", x0: 0, x1: 1, yref: "y2", y0: -noise, y1: noise, fillcolor: p.noise });
  }
  if (series.worst) {
    const [start, stop] = series.worst.map((t) => t + replay.origin);
    shapes.push({ ...box, xref: "x", x0: start, x1: stop, yref: "paper", y0: 0, y1: 1, fillcolor: p.worst });
  }
  return shapes;
}

function drawReplay(window_) {
  const replay = DATA.replays[shown.replay], series = replay.columns[shown.column];
  const lines = linesOf(replay, series);
  const noise = (series.noise || 0) * replay.errorFactor;
  const time = replay.fromStart ? "time from the start in s" : "time in s";
  const unit = replay.unit ? " in " + replay.unit : "";
  const ends = range([lines.time]) || [0, 1];
  const margin = 0.005 * (ends[1] - ends[0]) || 0.5;
  const whole = [ends[0] - margin, ends[1] + margin];
  draw("replay-figure", replayTraces(replay, lines), layout({
    xaxis: axis(time, { anchor: "y2", range: window_ || whole, zeroline: false, hoverformat: ".3f", showspikes: true,
      spikemode: "across", spikethickness: 1, spikedash: "solid", spikecolor: palette().zero, spikesnap: "cursor" }),
    yaxis: axis(shortened(replay.channel, 24) + unit, { domain: [0.38, 1], range: valueRange(lines) || undefined, zeroline: false }),
    yaxis2: axis("error in " + (replay.errorUnit || "its unit"), { domain: [0, 0.32], range: errorRange(lines, noise) }),
    shapes: replayShapes(replay, series), hovermode: "x unified", hoversubplots: "axis",
    margin: { l: 66, r: 8, t: 34, b: 44 },
  }));
  titleReplay(replay, series);
}

function titleReplay(replay, series) {
  const [before, after] = series.score.map((s) => (s === null ? null : s * replay.errorFactor));
  const title = document.getElementById("replay-title");
  title.textContent = `${replay.recording}, ${replay.labels[shown.column]} `;
  const detail = document.createElement("span");
  detail.className = "detail";
  detail.textContent = `${replay.heldOut ? "held out" : "fitted"}, ` +
    `${before === null ? "" : digits(before, 3) + " → "}${digits(after, 3)} ${replay.errorUnit}${ratio(after, before)}`;
  title.append(detail);
  const kept = column(series.time).length, thinned = kept < replay.samples;
  const parts = ["Error is simulated minus measured."];
  if (series.noise) parts.push("The grey band is twice the measurement noise.");
  if (series.worst) parts.push("Tinted: the second with the largest error after calibration.");
  if (thinned) parts.push(`Shown: ${kept} of ${replay.samples} samples, chosen so that no peak is lost.`);
  parts.push("Drag to zoom, double-click for everything.");
  document.getElementById("replay-caption").textContent = parts.join(" ");
}

function worstWindow() {
  const replay = DATA.replays[shown.replay], worst = replay.columns[shown.column].worst;
  if (!worst) return null;
  const spare = Math.max(1, 1.5 * (worst[1] - worst[0]));
  return [worst[0] + replay.origin - spare, worst[1] + replay.origin + spare];
}

function currentWindow() {
  const place = document.getElementById("replay-figure");
  return place.layout && place.layout.xaxis.range ? place.layout.xaxis.range.slice() : null;
}
